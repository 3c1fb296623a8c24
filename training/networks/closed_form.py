"""The closed-form estimator: from tensions to one candidate contact per segment, by statics alone.

At rest the cables' joint torques balance weight and contact. Against the unloaded state (q0, T0)
of the same command, with B_s the Jacobian of segment s's contact point,

    tau := J(q)' dT + (J(q) - J(q0))' T0 - (tau_weight(q) - tau_weight(q0)) = B_s(q)' f

are 2N equations for the two components of f, solved by generalised least squares. Each taut
cable's stretch T/k determines its true length, and Gauss-Newton on those gives the pose q.
Readings of variance v make tau's covariance v J' W J, with W one for taut cables and nearly zero
for slack ones, whose tension is known. docs/physics.md derives this.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from cablesense_base import Array
from cablesense_sim.equilibrium import EquilibriumError, solve_equilibrium
from cablesense_sim.mechanism import Mechanism
from cablesense_training.networks.compact import CompactKinematics, CompactPose, constant
from cablesense_training.networks.layers import one_hot_of_argmax

SLACK_WEIGHT = 1e-3
"""Variance of a slack cable's tension over that of a taut one's reading."""

POSE_SLACK_WEIGHT = 1e-5
"""Weight of a slack cable's length in the fit of the pose, over that of a taut one. It must not
bend the pose, but holds it where few are taut."""

_NUDGE_N = 1e-6
"""Added to forces to keep them off zero, so that they always have a direction."""

_LARGEST_N = 200.0
_LOG_PRIOR = -2.0 * math.log(_LARGEST_N)
"""Of a contact: uniform over the disc of forces up to the largest, but for pi."""

_STEP_RAD = 1e-4
"""Step of the central differences by the pose; their error is a part in 1e8."""

_MOST_POSE_CORRECTIONS = 4
_POSE_TOLERANCE_RAD = 1e-5
"""Where Gauss-Newton on the pose may stop: it moves a 200 N estimate by some millinewtons."""


def pose_corrections_for(mechanism: Mechanism) -> int:
    """Gauss-Newton steps that this arm's give under the largest force at its tip calls for.

    Each step about squares the error that is left. An arm without equilibrium under the force
    gets the largest number.
    """
    forces = np.zeros((2, mechanism.segment_count, 3))
    forces[0, -1, 1] = forces[1, -1, 2] = _LARGEST_N
    straight = np.zeros(mechanism.joint_count)
    try:
        give = np.abs(solve_equilibrium(mechanism, straight, forces).joint_angles_rad).max()
    except EquilibriumError:
        return _MOST_POSE_CORRECTIONS
    steps = 0
    while give > _POSE_TOLERANCE_RAD and steps < _MOST_POSE_CORRECTIONS:
        give, steps = give * give, steps + 1
    return steps


class Balance(NamedTuple):
    """Statics of B samples of an arm with N segments and M cables, at their true poses.

    Attributes:
        torque_n_m: (B, 2N) torques of the environment on the joints.
        precision: (B, 2N, 2N) inverse covariance of them.
        by_force_m, by_place, by_twist: as in `cablesense_sim.contact_location.TorqueBalance`.
        residual: (B, M) readings minus the tensions of the pose, in standard deviations; zero for
            a slack cable, unless it would be taut in the pose.
        taut: (B, M) one for taut cables, zero for slack ones.
        tension_n: (B, M) tensions that the torques were made of.
        jacobian_t_m: (B, 2N, M) torques that one newton in each cable makes.
        commanded_m: (B, M) cable lengths at the command, each but for a constant.
    """

    torque_n_m: Tensor
    precision: Tensor
    by_force_m: Tensor
    by_place: Tensor
    by_twist: Tensor
    residual: Tensor
    taut: Tensor
    tension_n: Tensor
    jacobian_t_m: Tensor
    commanded_m: Tensor


class Candidates(NamedTuple):
    """The contacts by statics, one for each segment.

    Attributes:
        force_n: (B, N, 2) y and z components in the frame of each segment at the commanded angles.
        covariance_n2: (B, N, 2, 2).
        explained: (B, N) chi² that each contact explains.
    """

    force_n: Tensor
    covariance_n2: Tensor
    explained: Tensor

    def log_evidence(self, trust: Tensor) -> Tensor:
        """(B, N) log evidence of a contact on each segment against none, by Laplace.

        Half the explained misfit, times a trust in it, and the Occam factor
        2 sqrt(det C) / F_max² of two components whose prior density is 1 / (pi F_max²) (MacKay,
        Information Theory, Inference, and Learning Algorithms, 2003, chapter 28).
        """
        c = self.covariance_n2
        determinant = c[..., 0, 0] * c[..., 1, 1] - c[..., 0, 1] * c[..., 1, 0]
        occam = 0.5 * torch.log(determinant) + math.log(2.0) + _LOG_PRIOR
        return 0.5 * trust * self.explained + occam

    def likeliest(self, evidence: Tensor) -> Likeliest:
        """The contact of most evidence (B, N)."""
        chosen = one_hot_of_argmax(evidence)[:, None].to(self.force_n.dtype)
        force_n = (chosen @ self.force_n)[:, 0]
        covariance_n2 = (chosen @ self.covariance_n2.flatten(2)).reshape(-1, 2, 2)
        along = force_n / torch.linalg.vector_norm(force_n, dim=-1, keepdim=True)
        across = torch.stack([-along[:, 1], along[:, 0]], dim=-1)
        axes = torch.stack([along, across], dim=1)
        variance_n2 = ((axes @ covariance_n2) * axes).sum(-1)
        return Likeliest(chosen, force_n, axes, torch.sqrt(variance_n2))


class Likeliest(NamedTuple):
    """One contact for each of B samples.

    Attributes:
        chosen: (B, 1, N) one for its segment, zero elsewhere.
        force_n: (B, 2) as in `Candidates`.
        axes: (B, 2, 2) unit vectors in rows: along the force, and across it.
        std_n: (B, 2) standard deviations of the force along these axes.
    """

    chosen: Tensor
    force_n: Tensor
    axes: Tensor
    std_n: Tensor


class ClosedForm(nn.Module):
    """`Balance` of tension differences (B, M) at commanded joint angles (B, 2N), in float64.

    Args:
        mechanism: the arm.
        reading_variance_n2: variance of one tension difference, N².
        pose_corrections: Gauss-Newton steps from the commanded to the true pose.
        unexplained_n2: what effects that no statics carries add to that variance; a slack cable
            is recognised by the sensor's own.
        held_by: the arm whose cable lengths the actuators hold at a command, if that has its
            holes elsewhere than `mechanism`.
        unread: (M, M) by which rows of differences as read become those of the tensions; None
            where readings are tensions.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        reading_variance_n2: float,
        pose_corrections: int,
        unexplained_n2: float = 0.0,
        held_by: Mechanism | None = None,
        unread: Array | None = None,
    ) -> None:
        super().__init__()
        self.kinematics = CompactKinematics(mechanism)
        self.unread = None if unread is None else constant(unread)
        sensor_n2 = max(reading_variance_n2, 1e-12)
        self.reading_variance_n2 = sensor_n2 + unexplained_n2
        self.slack_below_n = 4.0 * sensor_n2**0.5
        self.pose_corrections = pose_corrections
        self.springy = bool(mechanism.joint_stiffness_n_m_rad.any())
        self.compliance_m_n = constant(1.0 / mechanism.stiffness_n_m)
        self.pretension_n = constant(mechanism.pretension_n)
        self.contact_m = constant(mechanism.contact_m[:, None, None])
        self.spring_n_m_rad = constant(np.repeat(mechanism.joint_stiffness_n_m_rad, 2))
        self.held_by = None if held_by is None else CompactKinematics(held_by)
        if self.held_by is not None:
            straight = torch.zeros(1, mechanism.joint_count, dtype=torch.float64)
            self.excess_straight_m = nn.Buffer(self._excess_m(straight, self.kinematics(straight)))

    def forward(self, tension_difference_n: Tensor, joint_command_rad: Tensor) -> Balance:
        """The balance; the arm stands where the stretches of its taut cables say."""
        commanded = self.kinematics(joint_command_rad)
        unloaded_n, unbalanced = self._unloaded(joint_command_rad, commanded)
        tension, taut = self._loaded(tension_difference_n, unloaded_n)
        stretch = tension - self._at_command_n(joint_command_rad, commanded)
        missing = stretch = stretch * self.compliance_m_n
        weight = _weights(taut, POSE_SLACK_WEIGHT)
        angles, pose = joint_command_rad, commanded
        for _ in range(self.pose_corrections):
            pull = pose.jacobian_t_m @ (weight * missing)[..., None]
            angles = angles + (_gram_inverse(pose.jacobian_t_m, weight) @ pull)[..., 0]
            pose = self.kinematics(angles)
            missing = _missing_of(stretch - (pose.length_m - commanded.length_m), taut)
        jacobian = pose.jacobian_t_m
        gram = _gram_inverse(jacobian, _weights(taut, SLACK_WEIGHT))
        torque = (jacobian @ tension[..., None])[..., 0]
        torque = torque - self.kinematics.weight_n_m(pose) - unbalanced
        precision = gram * (1.0 / self.reading_variance_n2)
        return Balance(
            self._sprung(torque, angles),
            precision,
            *self.kinematics.levers(pose, commanded.frames),
            self._residual(missing, jacobian, precision, taut),
            taut,
            tension,
            jacobian,
            commanded.length_m,
        )

    def _loaded(self, tension_difference_n: Tensor, unloaded_n: Tensor) -> tuple[Tensor, Tensor]:
        """Tensions (B, M) behind differences as read, and one for each taut cable."""
        if self.unread is not None:
            tension_difference_n = tension_difference_n @ self.unread
        tension = tension_difference_n + unloaded_n
        taut = (tension > self.slack_below_n).to(tension.dtype)
        return tension * taut, taut

    def _residual(
        self, missing_m: Tensor, jacobian_t_m: Tensor, precision: Tensor, taut: Tensor
    ) -> Tensor:
        """The `residual` (B, M) of a `Balance`, from stretches that the pose does not explain."""
        variance_n2 = self.reading_variance_n2
        # variance of a cable's tension in the pose, over that of a reading
        leverage = variance_n2 * (jacobian_t_m * (precision @ jacobian_t_m)).sum(1)
        known_n = torch.sqrt(variance_n2 * (1.0 + (1.0 - taut) * leverage))
        return missing_m / (self.compliance_m_n * known_n)

    def _unloaded(self, angles: Tensor, commanded: CompactPose) -> tuple[Tensor, Tensor]:
        """Tensions (B, M) of taut cables under the arm's weight, and torques (B, 2N) left over.

        These are at the pose where the unloaded arm is assumed to stand: without corrections, the
        command.
        """
        tension = at_command = self._at_command_n(angles, commanded) + 0.0 * commanded.length_m
        stiffness = self.compliance_m_n.reciprocal() + 0.0 * tension
        pose, taken, at_angles = commanded, commanded, 0.0 * angles
        for _ in range(max(1, self.pose_corrections)):
            excess = self._unbalanced(pose, tension, angles)
            turn = _gram_inverse(pose.jacobian_t_m, stiffness) @ excess[..., None]
            angles = angles - turn[..., 0]
            pose = self.kinematics(angles)
            stretched = pose.length_m - commanded.length_m
            tension = at_command + stretched * stiffness
        if self.pose_corrections:
            taken, at_angles = pose, angles
        return tension, self._unbalanced(taken, tension, at_angles)

    def _unbalanced(self, pose: CompactPose, tension: Tensor, angles: Tensor) -> Tensor:
        """(B, 2N) torque of tensions and springs less that of the weight."""
        torque = (pose.jacobian_t_m @ tension[..., None])[..., 0]
        return self._sprung(torque - self.kinematics.weight_n_m(pose), angles)

    def _sprung(self, torque: Tensor, angles: Tensor) -> Tensor:
        return torque + self.spring_n_m_rad * angles if self.springy else torque

    def _at_command_n(self, angles: Tensor, commanded: CompactPose) -> Tensor:
        """Tensions (M,) or (B, M) if the arm stood where it is commanded."""
        if self.held_by is None:
            return self.pretension_n
        excess = self._excess_m(angles, commanded) - self.excess_straight_m
        return self.pretension_n + excess / self.compliance_m_n

    def _excess_m(self, angles: Tensor, commanded: CompactPose) -> Tensor:
        """(B, M) by which cables of this arm are longer than of the one that holds them."""
        assert self.held_by is not None
        return commanded.length_m - self.held_by(angles).length_m

    def contact_levers(self, balance: Balance) -> Tensor:
        """(B, N, 2, 2N) torques of unit forces, y and z, at the contact points of the arm file."""
        return balance.by_force_m[:, :, 1:] + self.contact_m * balance.by_place[:, :, 1:]

    def candidates(self, balance: Balance) -> Candidates:
        """Generalised least squares of the torques on every segment's two force components."""
        n = self.kinematics.segment_count
        lever, torque = self.contact_levers(balance), balance.torque_n_m[..., None]
        weighted = lever.reshape(-1, 2 * n, 2 * n) @ balance.precision
        pull = (weighted @ torque).reshape(-1, n, 2, 1)
        information = weighted.reshape(-1, n, 2, 2 * n) @ lever.transpose(-1, -2)
        covariance = inverse(information)
        force = covariance @ pull + _NUDGE_N
        explained = (force * (information @ force)).sum((2, 3))
        return Candidates(force[..., 0], covariance, explained)


class NearCommand(ClosedForm):
    """`ClosedForm` to second order in the give of a stiff arm: a thousand answers a second.

    The joints deflect by milliradians, so kinematics are linear about the command, and cable
    lengths quadratic. The expansion depends on the command alone, and the matrices that give the
    pose on that and on which cables are taut: `inference.session` computes both as seldom as they
    change. For arms of one pose correction, without joint springs, whose actuators hold the
    lengths of the arm itself. `jacobian_t_m` of the balance is that at the command.
    """

    def __init__(self, mechanism: Mechanism, *statics: Any, **options: Any) -> None:
        super().__init__(mechanism, *statics, **options)
        forward = _STEP_RAD * torch.eye(mechanism.joint_count, dtype=torch.float64)
        self.offsets = nn.Buffer(torch.cat([forward, -forward]))

    def forward(self, tension_difference_n: Tensor, joint_command_rad: Tensor) -> Balance:
        """See the base class."""
        n, m = self.kinematics.segment_count, self.kinematics.cable_count
        joints = 2 * n
        commanded = self.kinematics(joint_command_rad)
        unloaded_n, unbalanced = self._unloaded(joint_command_rad, commanded)
        at, by_angle = self._expand(joint_command_rad, commanded)
        jacobian, bend_by = commanded.jacobian_t_m, by_angle[:, :, : joints * m]

        # all that depends on which cables are taut does so through this one tensor
        tension, taut = self._loaded(tension_difference_n, unloaded_n)
        of_pose = _weights(taut, POSE_SLACK_WEIGHT)
        to_turn = (_gram_inverse(jacobian, of_pose) @ (jacobian * of_pose[:, None])).transpose(
            1, 2
        )
        gram = _gram_inverse(jacobian, _weights(taut, SLACK_WEIGHT))

        stretch = ((tension - self.pretension_n) * self.compliance_m_n)[:, None]
        turn = stretch @ to_turn
        half_bent = (turn @ bend_by).reshape(-1, joints, m) * 0.5 + jacobian
        turn = turn + (stretch - turn @ half_bent) @ to_turn
        sizes = [joints * m, 3 * n * joints, 3 * n * joints, n * joints, joints]
        bent, by_force, by_place, by_twist, own_weight = (
            part[:, 0] for part in (turn @ by_angle + at[:, None]).split(sizes, dim=2)
        )
        bent = bent.reshape(-1, joints, m)
        missing = _missing_of((stretch - turn @ (bent + jacobian) * 0.5)[:, 0], taut)
        torque = (bent @ tension[..., None])[..., 0] - own_weight - unbalanced
        precision = gram * (1.0 / self.reading_variance_n2)
        return Balance(
            torque,
            precision,
            by_force.reshape(-1, n, 3, joints),
            by_place.reshape(-1, n, 3, joints),
            by_twist.reshape(-1, n, joints),
            self._residual(missing, jacobian, precision, taut),
            taut,
            tension,
            jacobian,
            commanded.length_m,
        )

    def _expand(self, command_rad: Tensor, commanded: CompactPose) -> tuple[Tensor, Tensor]:
        """Kinematics (B, K) at the command and, by central differences, their slopes (B, 2N, K).

        They are the Jacobian, torques by force, place and twist, and those of the weight.
        """
        joints = 2 * self.kinematics.segment_count
        around = self.kinematics((command_rad[:, None] + self.offsets).reshape(-1, joints))
        frames = commanded.frames[:, None] + 0.0 * self.offsets[:, :1, None]
        at = self._flat(commanded, commanded.frames)
        sides = self._flat(around, frames.flatten(0, 1)).reshape(-1, 2, joints, at.shape[1])
        return at, (sides[:, 0] - sides[:, 1]) * (0.5 / _STEP_RAD)

    def _flat(self, pose: CompactPose, frames: Tensor) -> Tensor:
        levers, weight = self.kinematics.levers(pose, frames), self.kinematics.weight_n_m(pose)
        parts = [pose.jacobian_t_m, *levers, weight]
        return torch.cat([part.reshape(-1, part[0].numel()) for part in parts], dim=1)


def _weights(taut: Tensor, slack: float) -> Tensor:
    """One for taut cables, and that of `slack` for slack ones."""
    return taut * (1.0 - slack) + slack


def _missing_of(residual_m: Tensor, taut: Tensor) -> Tensor:
    """Residuals (B, M) of cable lengths; a slack cable may be longer than the pose needs."""
    return taut * residual_m + (1.0 - taut) * residual_m.clamp(max=0.0)


def _gram_inverse(jacobian_t: Tensor, weight: Tensor) -> Tensor:
    """Inverse (B, 2N, 2N) of J' W J, with weights (B, M)."""
    return inverse((jacobian_t * weight[:, None]) @ jacobian_t.transpose(1, 2))


def inverse(matrix: Tensor) -> Tensor:
    """Inverse of square matrices (..., k, k), in PyTorch and in an exported graph."""
    if torch.onnx.is_in_onnx_export():
        # ONNX itself has no inverse; ONNX Runtime does, as an operator of its own.
        return torch.onnx.ops.symbolic(
            "com.microsoft::Inverse", (matrix,), dtype=matrix.dtype, shape=matrix.shape, version=1
        )
    return torch.linalg.inv(matrix)
