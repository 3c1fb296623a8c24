"""The closed-form estimator: from tensions to one candidate contact per segment, by statics alone.

At rest the cables' joint torques balance weight and contact, slack or not:

    J(q)' T = tau_weight(q) + B_s(q)' f,

with B_s the Jacobian of segment s's contact point. Against the unloaded state (q0, T0) of the same
command this is

    tau := J(q)' dT + (J(q) - J(q0))' T0 - (tau_weight(q) - tau_weight(q0)) = B_s(q)' f,

2N equations for the two components of f, solved by generalised least squares for every segment in
turn; the segment whose misfit chi² is least is the contact. The pose q is not the commanded one:
the arm gives way. Each taut cable's stretch T/k determines its true length, and Gauss-Newton on
those lengths gives q.

Readings of equal variance v make tau's covariance v J' W J, with W one for taut cables and nearly
zero for slack ones, whose tension is known; with T = k J dq this compresses the M tensions without
loss.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from cablesense_sim.equilibrium import EquilibriumError, solve_equilibrium
from cablesense_sim.mechanism import Mechanism
from cablesense_training.networks.compact import CompactKinematics, CompactPose

SLACK_WEIGHT = 1e-3
"""Variance of a slack cable's tension over that of a taut one's reading."""

NUDGE_N = 1e-6
"""Added to weighed forces to keep them off zero, so that they always have a direction."""

_MOST_POSE_CORRECTIONS = 4
_POSE_TOLERANCE_RAD = 1e-5
"""Where Gauss-Newton on the pose may stop: it moves a 200 N estimate by some millinewtons."""


def pose_corrections_for(mechanism: Mechanism, force_n: float = 200.0) -> int:
    """Gauss-Newton steps that this arm's give under a force at its tip calls for.

    Each step about squares the error that is left, so a give of g rad needs n steps with g^(2^n)
    below the tolerance. An arm without equilibrium under the force gets the largest number.
    """
    forces = np.zeros((2, mechanism.segment_count, 3))
    forces[0, -1, 1] = forces[1, -1, 2] = force_n
    straight = np.zeros(mechanism.joint_count)
    try:
        give = np.abs(solve_equilibrium(mechanism, straight, forces).joint_angles_rad).max()
    except EquilibriumError:
        return _MOST_POSE_CORRECTIONS
    steps = 0
    while give > _POSE_TOLERANCE_RAD and steps < _MOST_POSE_CORRECTIONS:
        give, steps = give * give, steps + 1
    return steps


class Candidates(NamedTuple):
    """The contacts by statics, one for each segment, with the evidence for them.

    Attributes:
        force_n: (B, N, 2) y and z components in the frame of each segment at the commanded angles.
        covariance_n2: (B, N, 2, 2) of the force, N².
        taut: (B, M) one for taut cables, zero for slack ones.
        evidence: (B, 1, N) log evidence of a contact on each segment against none.
    """

    force_n: Tensor
    covariance_n2: Tensor
    taut: Tensor
    evidence: Tensor


Weighing = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]
"""Maps information and covariance (B, N, 2, 2) to matrices W (B, N, 2, 2) and constants (B, N):
the evidence of a force f is f' W f plus the constant."""


class JointBalance(NamedTuple):
    """Statics of B samples at their true poses; joints ordered pitches, then yaws.

    Attributes:
        lever: (B, N, 2, 2N) joint torques of unit forces along the normals of each segment at the
            commanded angles.
        precision: (B, 2N, 2N) inverse covariance of the torques.
        torque_n_m: (B, 2N, 1) torques of the environment on the joints.
        taut: (B, M) one for taut cables, zero for slack ones.
        tension_n: (B, M, 1) tensions that the torques were made of.
        jacobian_t_m: (B, 2N, M) torques that one newton in each cable makes.
        commanded_m: (B, M) cable lengths at the command.
    """

    lever: Tensor
    precision: Tensor
    torque_n_m: Tensor
    taut: Tensor
    tension_n: Tensor
    jacobian_t_m: Tensor
    commanded_m: Tensor


class TruePose(NamedTuple):
    """An arm of B samples where it stands, with what it was commanded; joints as `JointBalance`.

    Attributes:
        pose, commanded: kinematics there and at the command.
        normal_cross: `CompactKinematics.normal_cross` of the command.
        lever: (B, N, 2, 2N) as in `JointBalance`.
        taut: (B, M, 1) one for taut cables, zero for slack ones.
        tension_n: (B, M, 1).
        torque_n_m: (B, 2N, 1) torques of the environment on the joints.
        gram_inverse: (B, 2N, 2N) covariance of the torques, inverted, for readings of variance 1.
        residual_m: (B, M, 1) stretch by the readings, less that by the pose.
    """

    pose: CompactPose
    commanded: CompactPose
    normal_cross: Tensor
    lever: Tensor
    taut: Tensor
    tension_n: Tensor
    torque_n_m: Tensor
    gram_inverse: Tensor
    residual_m: Tensor


class ClosedForm(nn.Module):
    """Candidates from tension differences (B, M) and commanded joint angles (B, 2N), float64.

    Attributes:
        pose_slack_weight: that of a slack cable's length in the fit of the pose, over that of a
            taut one.

    Args:
        mechanism: the arm.
        reading_variance_n2: variance of one tension difference, N².
        pose_corrections: Gauss-Newton steps from the commanded to the true pose; 0 takes the
            command as the pose.
        unexplained_n2: what effects that no statics carries add to that variance; a slack cable
            is recognised by the sensor's own.
        held_by: the arm whose cable lengths the actuators hold at a command, where that is not
            `mechanism`: an arm whose holes are elsewhere than its controller assumes.
    """

    compliance_m_n: Tensor
    pretension_n: Tensor
    excess_straight_m: Tensor
    spring_n_m_rad: Tensor

    def __init__(
        self,
        mechanism: Mechanism,
        reading_variance_n2: float,
        pose_corrections: int,
        unexplained_n2: float = 0.0,
        held_by: Mechanism | None = None,
    ) -> None:
        super().__init__()
        self.kinematics = CompactKinematics(mechanism)
        sensor_n2 = max(reading_variance_n2, 1e-12)
        self.reading_variance_n2 = sensor_n2 + unexplained_n2
        self.pose_corrections = pose_corrections
        self.pose_slack_weight = SLACK_WEIGHT
        self.slack_below_n = 4.0 * sensor_n2**0.5
        compliance = 1.0 / mechanism.stiffness_n_m
        self.register_buffer("compliance_m_n", torch.as_tensor(compliance[:, None]))
        self.register_buffer("pretension_n", torch.as_tensor(mechanism.pretension_n[:, None]))
        self.held_by = None if held_by is None else CompactKinematics(held_by)
        if self.held_by is not None:
            straight = torch.zeros(1, mechanism.joint_count, 1, dtype=torch.float64)
            excess = self._excess_m(straight, self.kinematics(straight))
            self.register_buffer("excess_straight_m", excess)
        self.springy = bool(mechanism.joint_stiffness_n_m_rad.any())
        if self.springy:
            spring = np.tile(mechanism.joint_stiffness_n_m_rad, 2)[:, None]
            self.register_buffer("spring_n_m_rad", torch.as_tensor(spring))

    def weigh(
        self, tension_difference_n: Tensor, joint_command_rad: Tensor, weighing: Weighing
    ) -> Candidates:
        """The candidates, and the evidence for them."""
        balance = self.balance(tension_difference_n, joint_command_rad)
        force, covariance, information, _ = self.least_squares(balance)
        trusted, constant = weighing(information, covariance)
        rows = force[:, :, None]
        evidence = (rows @ trusted * rows).sum((2, 3)) + constant
        return Candidates(force + NUDGE_N, covariance, balance.taut, evidence[:, None])

    def balance(self, tension_difference_n: Tensor, joint_command_rad: Tensor) -> JointBalance:
        """Torques of the environment on the joints at the true pose."""
        found = self.true_pose(tension_difference_n, joint_command_rad)
        return JointBalance(
            lever=found.lever,
            precision=found.gram_inverse * (1.0 / self.reading_variance_n2),
            torque_n_m=found.torque_n_m,
            taut=found.taut[..., 0],
            tension_n=found.tension_n,
            jacobian_t_m=found.pose.jacobian_t_m,
            commanded_m=found.commanded.span_m.sum((1, 2)),
        )

    def true_pose(self, tension_difference_n: Tensor, joint_command_rad: Tensor) -> TruePose:
        """Where the arm stands, by the stretches of its taut cables."""
        angles, commanded, normal_cross = self.at_command(joint_command_rad)
        unloaded_tension, unloaded_torque = self.unloaded(angles, commanded, normal_cross)

        tension = tension_difference_n[:, :, None] + unloaded_tension
        taut = (tension > self.slack_below_n).to(tension.dtype)
        tension = tension * taut
        weight = taut * (1.0 - self.pose_slack_weight) + self.pose_slack_weight
        stretch = (tension - self._at_command_n(angles, commanded)) * self.compliance_m_n
        pose, stretched = commanded, 0.0 * stretch
        inverse_gram = gram_inverse(commanded.jacobian_t_m, weight)
        for step in range(self.pose_corrections):
            if step:
                inverse_gram = gram_inverse(pose.jacobian_t_m, weight)
                missing = stretch - stretched
                # a slack cable may hang as loosely as the pose leaves it
                missing = taut * missing + (1.0 - taut) * missing.clamp(max=0.0)
                moved = inverse_gram @ (pose.jacobian_t_m @ (weight * missing))
            else:
                moved = inverse_gram @ (pose.jacobian_t_m @ (weight * stretch))
            angles = angles + moved
            pose = self.kinematics(angles)
            stretched = (pose.span_m - commanded.span_m).sum((1, 2))[..., None]
        if self.pose_slack_weight != SLACK_WEIGHT:
            weight = taut * (1.0 - SLACK_WEIGHT) + SLACK_WEIGHT
            inverse_gram = gram_inverse(pose.jacobian_t_m, weight)
        lever, weight_torque = self.kinematics.levers(pose, normal_cross)
        torque = pose.jacobian_t_m @ tension - weight_torque - unloaded_torque
        if self.springy:
            torque = torque + self.spring_n_m_rad * angles
        return TruePose(
            pose,
            commanded,
            normal_cross,
            lever,
            taut,
            tension,
            torque,
            inverse_gram,
            stretch - stretched,
        )

    def at_command(self, joint_command_rad: Tensor) -> tuple[Tensor, CompactPose, Tensor]:
        """Angles (B, 2N, 1), pitches first, pose and `normal_cross` of joint commands (B, 2N)."""
        n = self.kinematics.segment_count
        angles = joint_command_rad.reshape(-1, n, 2).transpose(1, 2).reshape(-1, 2 * n, 1)
        commanded = self.kinematics(angles)
        return angles, commanded, self.kinematics.normal_cross(commanded)

    def unloaded(
        self, angles: Tensor, commanded: CompactPose, normal_cross: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Tensions under the arm's own weight, and the joint torque that they leave unbalanced.

        Tensions are (B, M, 1), of cables assumed taut; the torque is (B, 2N, 1), that at the pose
        where the unloaded arm is assumed to stand: the command, without corrections.
        """
        pose = commanded
        stretched = (commanded.span_m - commanded.span_m).sum((1, 2))[..., None]
        at_command = self._at_command_n(angles, commanded)
        tension = at_command + stretched
        for _ in range(max(1, self.pose_corrections)):
            _, weight_torque = self.kinematics.levers(pose, normal_cross)
            stiffness = self.compliance_m_n.reciprocal() + 0.0 * tension
            inverse_gram = gram_inverse(pose.jacobian_t_m, stiffness)
            unbalanced = weight_torque - pose.jacobian_t_m @ tension
            if self.springy:
                unbalanced = unbalanced - self.spring_n_m_rad * angles
            angles = angles + inverse_gram @ unbalanced
            pose = self.kinematics(angles)
            stretched = (pose.span_m - commanded.span_m).sum((1, 2))[..., None]
            tension = at_command + stretched / self.compliance_m_n
        taken = pose if self.pose_corrections else commanded
        _, weight_torque = self.kinematics.levers(taken, normal_cross)
        unbalanced = taken.jacobian_t_m @ tension - weight_torque
        if self.springy and self.pose_corrections:
            unbalanced = unbalanced + self.spring_n_m_rad * angles
        return tension, unbalanced

    def _at_command_n(self, angles: Tensor, commanded: CompactPose) -> Tensor:
        """Tensions (M, 1) or (B, M, 1) if the arm stood where it is commanded."""
        if self.held_by is None:
            return self.pretension_n
        excess = self._excess_m(angles, commanded) - self.excess_straight_m
        return self.pretension_n + excess / self.compliance_m_n

    def _excess_m(self, angles: Tensor, commanded: CompactPose) -> Tensor:
        """(B, M, 1) by which cables of this arm are longer than of the one that holds them."""
        assert self.held_by is not None
        return (commanded.span_m - self.held_by(angles).span_m).sum((1, 2))[..., None]

    def least_squares(self, balance: JointBalance) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Generalised least squares of the torques on every segment's two force components.

        Gives forces (B, N, 2), their covariance and its inverse, the information (B, N, 2, 2), and
        chi² of "no contact" (B,) with 2N degrees of freedom.
        """
        n = self.kinematics.segment_count
        lever, precision, torque = balance[:3]
        weighted = lever.reshape(-1, 2 * n, 2 * n) @ precision
        pull = (weighted @ torque).reshape(-1, n, 2, 1)
        information = weighted.reshape(-1, n, 2, 2 * n) @ lever.transpose(-1, -2)
        covariance = inverse(information)
        force = covariance @ pull
        misfit_none = (torque * (precision @ torque)).sum((1, 2))
        return force.reshape(-1, n, 2), covariance, information, misfit_none


def gram_inverse(jacobian_t: Tensor, weight: Tensor) -> Tensor:
    """Inverse (B, 2N, 2N) of J' W J, with weights (B, M, 1)."""
    return inverse(jacobian_t @ (jacobian_t.transpose(1, 2) * weight))


def inverse(matrix: Tensor) -> Tensor:
    """Inverse of square matrices (..., k, k), in PyTorch and in an exported graph."""
    if torch.onnx.is_in_onnx_export():
        # ONNX itself has no inverse; ONNX Runtime does, as an operator of its own.
        inverted: Tensor = torch.onnx.ops.symbolic(
            "com.microsoft::Inverse", (matrix,), dtype=matrix.dtype, shape=matrix.shape, version=1
        )
        return inverted
    return torch.linalg.inv(matrix)


def own_blocks(matrix: Tensor, segments: int) -> Tensor:
    """The 2 by 2 blocks (B, N, 2, 2) on the diagonal of (B, 2N, 2N)."""
    blocks = matrix.reshape(-1, segments, 2, segments, 2)
    return torch.stack([blocks[:, s, :, s] for s in range(segments)], dim=1)
