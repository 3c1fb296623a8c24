"""The closed-form estimator: from tensions to one candidate contact per segment, by statics alone.

At rest the cables' joint torques balance weight and contact, slack or not:

    J(q)' T = tau_weight(q) + B_s(q)' f,

with B_s the Jacobian of segment s's contact point. Against the unloaded state (q0, T0) of the same command this is

    tau := J(q)' dT + (J(q) - J(q0))' T0 - (tau_weight(q) - tau_weight(q0)) = B_s(q)' f,

2N equations for the two components of f, solved by generalised least squares for every segment in turn; the segment
whose misfit chi² is least is the contact. The pose q is not the commanded one: the arm gives way. Each taut cable's
stretch T/k tells its true length, and Gauss-Newton on those lengths gives q.

Readings of equal variance v make tau's covariance v J' W J, with W one for taut cables and nearly zero for slack ones,
whose tension is known; with T = k J dq this compresses the M tensions without loss.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from cablesense_sim import kinematics
from cablesense_sim.mechanism import Mechanism

SLACK_WEIGHT = 1e-3
"""Variance of a slack cable's tension over that of a taut one's reading."""


class Candidates(NamedTuple):
    """What statics says, one hypothesis per segment, in units of newtons.

    Attributes:
        force_n: (B, N, 2) y and z components in the frame of each segment at the commanded angles.
        information: (B, N, 2, 2) inverse covariance of the force, 1/N².
        misfit: (B, N) chi² of "a contact on segment s", 2N - 2 degrees of freedom.
        misfit_none: (B,) chi² of "no contact", 2N degrees of freedom.
        pose_rad: (B, 2N) the true joint angles as the cables' stretch tells them.
        tensions_n: (B, M) tensions, slack ones zero.
    """

    force_n: Tensor
    information: Tensor
    misfit: Tensor
    misfit_none: Tensor
    pose_rad: Tensor
    tensions_n: Tensor


class ClosedForm(nn.Module):
    """Candidates from tension differences (B, M) and commanded joint angles (B, 2N), float64.

    Args:
        mechanism: the arm.
        reading_variance_n2: variance of one tension difference, N².
        pose_corrections: Gauss-Newton steps from the commanded to the true pose; 0 takes the command as the pose.
    """

    def __init__(
        self, mechanism: Mechanism, reading_variance_n2: float, pose_corrections: int
    ) -> None:
        super().__init__()
        self.mechanism = mechanism
        self.reading_variance_n2 = max(reading_variance_n2, 1e-12)
        self.pose_corrections = pose_corrections
        self.slack_below_n = 4.0 * self.reading_variance_n2**0.5
        constant = torch.as_tensor
        self.register_buffer("stiffness_n_m", constant(mechanism.stiffness_n_m))
        self.register_buffer("pretension_n", constant(mechanism.pretension_n))

    def forward(self, tension_difference_n: Tensor, joint_command_rad: Tensor) -> Candidates:
        command = joint_command_rad
        lengths = self._span_sum(kinematics.spans(self.mechanism, command))
        unloaded, unloaded_tension = self._unloaded(command, lengths)
        tension = unloaded_tension + tension_difference_n
        taut = (tension > self.slack_below_n).to(tension.dtype)
        tension = tension * taut
        weight = taut + SLACK_WEIGHT * (1.0 - taut)
        pose, jacobian, inverse = self._true_pose(command, lengths, tension, weight)
        difference = tension - unloaded_tension
        torque = _transposed_times(jacobian, difference)
        if self.pose_corrections:
            unloaded_jacobian = kinematics.cable_jacobian_m(self.mechanism, unloaded)
            torque = (
                torque
                + _transposed_times(jacobian - unloaded_jacobian, unloaded_tension)
                - kinematics.gravity_torques_n_m(self.mechanism, pose)
                + kinematics.gravity_torques_n_m(self.mechanism, unloaded)
            )
        return self._least_squares(command, pose, tension, torque, inverse)

    def _unloaded(self, command: Tensor, lengths: Tensor) -> tuple[Tensor, Tensor]:
        """Pose and tensions under the arm's own weight, all cables taut, by Gauss-Newton on the balance."""
        pose, tension = command, self.pretension_n.expand(command.shape[0], -1)
        for _ in range(max(1, self.pose_corrections)):
            span = kinematics.spans(self.mechanism, pose)
            jacobian = kinematics.interleave(span)
            tension = self.pretension_n + self.stiffness_n_m * (self._span_sum(span) - lengths)
            left = kinematics.gravity_torques_n_m(self.mechanism, pose) - _transposed_times(
                jacobian, tension
            )
            moved = _times(_gram_inverse(jacobian, self.stiffness_n_m), left)
            tension = tension + self.stiffness_n_m * _times(jacobian, moved)
            pose = pose + moved
        return pose, tension

    def _true_pose(
        self, command: Tensor, lengths: Tensor, tension: Tensor, weight: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Pose, its cable Jacobian, and the inverse of J' W J there."""
        pose = command
        target = lengths + (tension - self.pretension_n) / self.stiffness_n_m
        span = kinematics.spans(self.mechanism, pose)
        jacobian = kinematics.interleave(span)
        inverse = _gram_inverse(jacobian, weight)
        for _ in range(self.pose_corrections):
            short = target - self._span_sum(span)
            pose = pose + _times(inverse, _transposed_times(jacobian, weight * short))
            span = kinematics.spans(self.mechanism, pose)
            jacobian = kinematics.interleave(span)
            inverse = _gram_inverse(jacobian, weight)
        return pose, jacobian, inverse

    def _least_squares(
        self, command: Tensor, pose: Tensor, tension: Tensor, torque: Tensor, inverse: Tensor
    ) -> Candidates:
        """Generalised least squares of the torque on every segment's two force components."""
        normal = kinematics.segment_rotations(self.mechanism, command)[..., 1:]
        contact = kinematics.contact_jacobians_m(self.mechanism, pose)
        lever = normal.transpose(-1, -2) @ contact
        precision = inverse / self.reading_variance_n2
        weighted = lever @ precision[:, None]
        information = weighted @ lever.transpose(-1, -2)
        pull = (weighted @ torque[:, None, :, None])[..., 0]
        force = (_inverse_2x2(information) @ pull[..., None])[..., 0]
        misfit_none = (torque * _times(precision, torque)).sum(-1)
        misfit = misfit_none[:, None] - (pull * force).sum(-1)
        return Candidates(force, information, misfit, misfit_none, pose, tension)

    def _span_sum(self, span: kinematics.Spans) -> Tensor:
        length: Tensor = span.length_m
        return length.sum(-1)


def _times(matrix: Tensor, vector: Tensor) -> Tensor:
    return (matrix @ vector[..., None])[..., 0]


def _transposed_times(matrix: Tensor, vector: Tensor) -> Tensor:
    return (vector[..., None, :] @ matrix)[..., 0, :]


def _gram_inverse(jacobian: Tensor, weight: Tensor) -> Tensor:
    gram = jacobian.transpose(-1, -2) @ (weight[..., None] * jacobian)
    return torch.linalg.inv(gram)


def _inverse_2x2(matrix: Tensor) -> Tensor:
    a, b = matrix[..., 0, 0], matrix[..., 0, 1]
    c, d = matrix[..., 1, 0], matrix[..., 1, 1]
    adjugate = torch.stack([torch.stack([d, -b], -1), torch.stack([-c, a], -1)], -2)
    return adjugate / (a * d - b * c)[..., None, None]
