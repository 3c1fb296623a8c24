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

from cablesense_sim.mechanism import Mechanism
from cablesense_training.physics.compact import CompactKinematics, Pose

SLACK_WEIGHT = 1e-3
"""Variance of a slack cable's tension over that of a taut one's reading."""


class Candidates(NamedTuple):
    """What statics says, one hypothesis per segment, in units of newtons.

    Attributes:
        force_n: (B, N, 2) y and z components in the frame of each segment at the commanded angles.
        covariance_n2: (B, N, 2, 2) of the force, N².
        misfit: (B, N) chi² of "a contact on segment s", 2N - 2 degrees of freedom.
        misfit_none: (B,) chi² of "no contact", 2N degrees of freedom.
        tensions_n: (B, M) tensions, slack ones zero.
    """

    force_n: Tensor
    covariance_n2: Tensor
    misfit: Tensor
    misfit_none: Tensor
    tensions_n: Tensor


class ClosedForm(nn.Module):
    """Candidates from tension differences (B, M) and commanded joint angles (B, 2N), float64.

    Args:
        mechanism: the arm.
        reading_variance_n2: variance of one tension difference, N².
        pose_corrections: Gauss-Newton steps from the commanded to the true pose; 0 takes the command as the pose.
    """

    stiffness_n_m: Tensor
    pretension_n: Tensor

    def __init__(
        self, mechanism: Mechanism, reading_variance_n2: float, pose_corrections: int
    ) -> None:
        super().__init__()
        self.kinematics = CompactKinematics(mechanism)
        self.reading_variance_n2 = max(reading_variance_n2, 1e-12)
        self.pose_corrections = pose_corrections
        self.slack_below_n = 4.0 * self.reading_variance_n2**0.5
        self.register_buffer("stiffness_n_m", torch.as_tensor(mechanism.stiffness_n_m))
        self.register_buffer("pretension_n", torch.as_tensor(mechanism.pretension_n))

    def forward(self, tension_difference_n: Tensor, joint_command_rad: Tensor) -> Candidates:
        """See `Candidates`."""
        n = self.kinematics.segment_count
        angles = joint_command_rad.reshape(-1, n, 2).transpose(1, 2)
        commanded = self.kinematics(angles)
        unloaded_tension, unloaded_balance = self._unloaded(angles, commanded)
        normal_cross = self.kinematics.normal_cross(commanded.rotations)
        gram_rows = commanded.jacobian_t_m.transpose(1, 2)

        tension = unloaded_tension + tension_difference_n
        taut = (tension > self.slack_below_n).to(tension.dtype)
        tension = tension * taut
        weight = taut + SLACK_WEIGHT * (1.0 - taut)
        pose = commanded
        inverse = _inverse((commanded.jacobian_t_m * weight[:, None]) @ gram_rows)
        stretch = (tension - self.pretension_n) / self.stiffness_n_m
        for _ in range(self.pose_corrections):
            short = stretch - (pose.span_sum_m - commanded.span_sum_m)
            moved = inverse @ (pose.jacobian_t_m @ (weight * short)[..., None])
            angles = angles + moved.reshape(-1, 2, n)
            pose = self.kinematics(angles)
            inverse = _inverse(
                (pose.jacobian_t_m * weight[:, None]) @ pose.jacobian_t_m.transpose(1, 2)
            )
        torque = (pose.jacobian_t_m @ tension[..., None])[..., 0] - pose.gravity_n_m
        torque = torque - unloaded_balance
        lever = self.kinematics.levers(pose, normal_cross)
        return self._least_squares(lever, inverse, torque[..., None], tension)

    def _unloaded(self, angles: Tensor, commanded: Pose) -> tuple[Tensor, Tensor]:
        """Tensions (B, M) under the arm's own weight, all taut, and what their torque leaves unbalanced (B, 2N)."""
        pose, n = commanded, self.kinematics.segment_count
        tension = self.pretension_n.expand(angles.shape[0], -1)
        for _ in range(max(1, self.pose_corrections)):
            balance = pose.gravity_n_m[..., None] - pose.jacobian_t_m @ tension[..., None]
            gram = (pose.jacobian_t_m * self.stiffness_n_m) @ pose.jacobian_t_m.transpose(1, 2)
            moved = _inverse(gram) @ balance
            angles = angles + moved.reshape(-1, 2, n)
            pose = self.kinematics(angles)
            tension = self.pretension_n + self.stiffness_n_m * (
                pose.span_sum_m - commanded.span_sum_m
            )
        balance = (pose.jacobian_t_m @ tension[..., None])[..., 0] - pose.gravity_n_m
        return tension, balance

    def _least_squares(
        self, lever: Tensor, inverse: Tensor, torque: Tensor, tension: Tensor
    ) -> Candidates:
        """Generalised least squares of torques (B, 2N, 1) on every segment's two force components."""
        precision = inverse / self.reading_variance_n2
        weighted = lever @ precision[:, None]
        information = weighted @ lever.transpose(-1, -2)
        pull = weighted @ torque[:, None]
        covariance = _inverse(information)
        force = covariance @ pull
        misfit_none = (torque * (precision @ torque)).sum((1, 2))
        misfit = misfit_none[:, None] - (pull * force).sum((2, 3))
        return Candidates(force[..., 0], covariance, misfit, misfit_none, tension)


def _inverse(matrix: Tensor) -> Tensor:
    if torch.onnx.is_in_onnx_export():
        # ONNX itself has no inverse; ONNX Runtime does, as an operator of its own.
        inverted: Tensor = torch.onnx.ops.symbolic(
            "com.microsoft::Inverse", (matrix,), dtype=matrix.dtype, shape=matrix.shape, version=1
        )
        return inverted
    return torch.linalg.inv(matrix)
