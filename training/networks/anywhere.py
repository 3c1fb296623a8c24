"""A contact anywhere on the arm: the torques that tensions show, and those that contacts make.

Statics gives the torques of the environment on the joints and those of unit forces on every
segment (`cablesense_sim.contact_location.TorqueBalance`). The posterior of place and force follows
from them outside the graph (`inference.anywhere`). A network learns from the set of taut cables
what the sensors' steps and slack cables make of the torques: a shift of at most one standard
deviation, and a factor of the deviations.
"""

from __future__ import annotations

from typing import ClassVar, NamedTuple

import torch
from torch import Tensor, nn

from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.effects.registry import amended
from cablesense_training.networks.closed_form import SLACK_WEIGHT, ClosedForm, gram_inverse
from cablesense_training.networks.compact import AxialLevers, CompactPose
from cablesense_training.networks.layers import ContactNetwork, StatedSpread
from cablesense_training.networks.statics import exact_statics, unreading

_WIDTH = 32
_STEP_RAD = 1e-4
"""Step of the central differences by the pose; their error is a part in 1e8."""
_POSE_SLACK_WEIGHT = 1e-5
"""A slack cable lacks up to 100 N, a thousand standard deviations, and must not bend the pose. It
holds the pose where few cables are taut."""
_LEAST_CORRECTIONS = 2
"""Residuals of a stiff arm's cable lengths need one more than its torques."""


class ContactBalance(NamedTuple):
    """Statics of B samples of an arm with N segments and M cables; joints in the arm's order.

    Attributes:
        torque_n_m: (B, 2N) torques of the environment.
        precision: (B, 2N, 2N) inverse covariance of them.
        by_force_m: (B, N, 3, 2N) torques of unit forces at the joint centre of each segment, along
            the axes of the segment at the commanded angles.
        by_place: (B, N, 3, 2N) their derivative by the place on the segment.
        by_twist: (B, N, 2N) torques of unit moments about the axes of the segments.
        residual: (B, M) readings minus the tensions of the pose, in standard deviations. Of
            a slack cable it is zero, unless the cable would be taut in the pose.
        taut: (B, M) one for taut cables, zero for slack ones.
    """

    torque_n_m: Tensor
    precision: Tensor
    by_force_m: Tensor
    by_place: Tensor
    by_twist: Tensor
    residual: Tensor
    taut: Tensor


class _Statics(NamedTuple):
    """What statics alone gives: as in `ContactBalance`, in its order.

    Attributes:
        gram_inverse: (B, 2N, 2N) precision of the torques for readings of variance 1.
        residual_m: (B, M) stretch by the readings, less that by the pose.
        leverage: (B, M) variance of a cable's tension in the pose, over that of a reading.
    """

    torque_n_m: Tensor
    gram_inverse: Tensor
    by_force_m: Tensor
    by_place: Tensor
    by_twist: Tensor
    residual_m: Tensor
    leverage: Tensor
    taut: Tensor


class ExactPose(nn.Module):
    """The statics of an arm at its true pose.

    Args:
        closed_form: the arm's.
        levers: the torques of forces along all axes.
    """

    in_order: Tensor

    def __init__(self, closed_form: ClosedForm, levers: AxialLevers) -> None:
        super().__init__()
        self.closed_form, self.levers = closed_form, levers
        pitches_then_yaws = torch.arange(2 * levers.segment_count).reshape(2, -1)
        self.register_buffer("in_order", pitches_then_yaws.T.flatten())

    def forward(self, difference_n: Tensor, command_rad: Tensor) -> _Statics:
        """Of differences (B, M) at commands (B, 2N)."""
        found = self.closed_form.true_pose(difference_n, command_rad)
        by_force, by_place, by_twist = self.levers(found.pose, found.commanded.frames)
        order, jacobian = self.in_order, found.pose.jacobian_t_m
        return _Statics(
            found.torque_n_m[..., 0].index_select(1, order),
            found.gram_inverse.index_select(1, order).index_select(2, order),
            by_force.index_select(3, order),
            by_place.index_select(3, order),
            by_twist.index_select(2, order),
            found.residual_m[..., 0],
            (jacobian * (found.gram_inverse @ jacobian)).sum(1),
            found.taut[..., 0],
        )


class NearCommand(ExactPose):
    """The same of a stiff arm, expanded about the commanded pose: fewer operations a sample.

    Kinematics are linear in the joints' give, which is a few milliradians, and lengths quadratic.
    """

    offsets: Tensor

    def __init__(self, closed_form: ClosedForm, levers: AxialLevers) -> None:
        super().__init__(closed_form, levers)
        forward = _STEP_RAD * torch.eye(2 * levers.segment_count, dtype=torch.float64)
        self.register_buffer("offsets", torch.cat([forward, -forward])[:, :, None])

    def forward(self, difference_n: Tensor, command_rad: Tensor) -> _Statics:
        """See the base class."""
        exact, order = self.closed_form, self.in_order
        n, m = exact.kinematics.segment_count, exact.kinematics.cable_count
        joints = 2 * n
        angles, commanded, normal_cross = exact.at_command(command_rad)
        unloaded_n, unbalanced = exact.unloaded(angles, commanded, normal_cross)
        at, by_angle = self._expand(angles, commanded, normal_cross)
        jacobian = at[:, : joints * m].reshape(-1, joints, m)
        bend_by = by_angle[:, :, : joints * m]

        tension = difference_n + unloaded_n[..., 0]
        # all that depends on which cables are taut does so through this one tensor
        taut = (tension > exact.slack_below_n).to(tension.dtype)
        tension = (tension * taut)[:, None]
        weight = taut[:, :, None]
        of_pose = weight * (1.0 - _POSE_SLACK_WEIGHT) + _POSE_SLACK_WEIGHT
        to_turn = (gram_inverse(jacobian, of_pose) @ jacobian).transpose(1, 2) * of_pose
        spread = weight * (1.0 - SLACK_WEIGHT) + SLACK_WEIGHT
        precision = gram_inverse(jacobian, spread)

        stretch = (tension - exact.pretension_n.T) * exact.compliance_m_n.T
        turn = stretch @ to_turn
        half_bent = (turn @ bend_by).reshape(-1, joints, m) * 0.5 + jacobian
        turn = turn + (stretch - turn @ half_bent) @ to_turn
        sizes = [joints * m, 3 * n * joints, 3 * n * joints, n * joints, joints]
        parts = (turn @ by_angle + at[:, None]).split(sizes, dim=2)
        bent, by_force, by_place, by_twist, own_weight = parts
        bent = bent.reshape(-1, joints, m)
        residual = stretch - turn @ (bent + jacobian) * 0.5
        torque = tension @ bent.transpose(1, 2) - own_weight
        return _Statics(
            torque[:, 0] - unbalanced[..., 0].index_select(1, order),
            precision,
            by_force.reshape(-1, n, 3, joints),
            by_place.reshape(-1, n, 3, joints),
            by_twist.reshape(-1, n, joints),
            residual[:, 0],
            (jacobian * (precision @ jacobian)).sum(1),
            taut,
        )

    def _expand(
        self, angles: Tensor, commanded: CompactPose, normal_cross: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Kinematics (B, K) at the command, flattened, and derivatives (B, 2N, K) by the angles.

        They are the Jacobian, torques by force, place and twist, and those of the weight, by
        central differences.
        """
        n = self.closed_form.kinematics.segment_count
        joints, some = 2 * n, 0.0 * self.offsets[:, :1]
        around = self.closed_form.kinematics(
            (angles[:, None] + self.offsets).reshape(-1, joints, 1)
        )
        frames = (commanded.frames[:, None] + some).reshape(-1, 3, 3 * n + 3)
        crosses = (normal_cross[:, None] + some).reshape(-1, 6 * n + 6, 3)
        at = self._flat(commanded, commanded.frames, normal_cross)
        sides = self._flat(around, frames, crosses).reshape(-1, 2, joints, at.shape[1])
        by_angle = (sides[:, 0] - sides[:, 1]) * (0.5 / _STEP_RAD)
        return at, by_angle.index_select(1, self.in_order)

    def _flat(self, pose: CompactPose, frames: Tensor, normal_cross: Tensor) -> Tensor:
        order = self.in_order
        by_force, by_place, by_twist = self.levers(pose, frames)
        _, weight = self.closed_form.kinematics.levers(pose, normal_cross)
        parts = [
            pose.jacobian_t_m.index_select(1, order),
            by_force.index_select(3, order),
            by_place.index_select(3, order),
            by_twist.index_select(2, order),
            weight.index_select(1, order),
        ]
        return torch.cat([part.reshape(-1, part[0].numel()) for part in parts], dim=1)


class AnywhereStatics(ContactNetwork):
    """The balance of tension differences (B, M) at joint commands (B, 2N), in float64.

    Args:
        arm: the arm.
        closed_form: its statics.
    """

    pose_aware: ClassVar[bool] = True
    identity: Tensor
    unread: Tensor | None

    def __init__(self, arm: Arm, closed_form: ClosedForm) -> None:
        super().__init__(arm.cable_count, arm.segment_count)
        self.closed_form = closed_form
        stiff = closed_form.pose_corrections <= 1
        exact = stiff and closed_form.held_by is None and not closed_form.springy
        closed_form.pose_slack_weight = _POSE_SLACK_WEIGHT
        closed_form.pose_corrections = max(_LEAST_CORRECTIONS, closed_form.pose_corrections)
        mechanism = amended(mechanism_of(arm), entries_of(arm))
        levers = AxialLevers(closed_form.kinematics, mechanism)
        self.statics = (NearCommand if exact else ExactPose)(closed_form, levers)
        self.spread = StatedSpread(1)
        self.hidden = nn.Linear(arm.cable_count, _WIDTH)
        self.heads = nn.Linear(_WIDTH, arm.joint_count + 1, bias=False)
        nn.init.zeros_(self.heads.weight)
        self.register_buffer("identity", torch.eye(arm.joint_count))
        unread = unreading(arm)
        self.register_buffer("unread", None if unread is None else torch.as_tensor(unread))
        self.double()

    @classmethod
    def for_arm(cls, arm: Arm, tare_samples: int = 50) -> AnywhereStatics:
        """The network of an arm, its sensors, and a tare averaged over `tare_samples` readings."""
        return cls(arm, exact_statics(arm, tare_samples))

    def adapt(self, tension_difference_n: Tensor, magnitude_n: Tensor) -> None:
        """Nothing is scaled: torques count in their own standard deviations."""

    def forward(
        self, tension_difference_n: Tensor, joint_command_rad: Tensor | None = None
    ) -> ContactBalance:
        """See the base class; the commanded angles are needed."""
        assert joint_command_rad is not None
        balance = self.untaught(tension_difference_n, joint_command_rad)
        learnt = self.corrected(balance.torque_n_m, balance.precision, balance.taut)
        return balance._replace(torque_n_m=learnt[0], precision=learnt[1])

    def untaught(self, tension_difference_n: Tensor, joint_command_rad: Tensor) -> ContactBalance:
        """The balance by statics alone."""
        difference_n = tension_difference_n.double()
        if self.unread is not None:
            difference_n = difference_n @ self.unread
        found = self.statics(difference_n, joint_command_rad.double())
        taut, slack = found.taut, 1.0 - found.taut
        variance_n2 = self.closed_form.reading_variance_n2
        known_n = torch.sqrt(1.0 + slack * found.leverage) * variance_n2**0.5
        residual = found.residual_m / (self.closed_form.compliance_m_n[:, 0] * known_n)
        return ContactBalance(
            torque_n_m=found.torque_n_m,
            precision=found.gram_inverse * (1.0 / variance_n2),
            by_force_m=found.by_force_m,
            by_place=found.by_place,
            by_twist=found.by_twist,
            residual=taut * residual + slack * residual.clamp(max=0.0),
            taut=taut,
        )

    def corrected(
        self, torque_n_m: Tensor, precision: Tensor, taut: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Torques (B, 2N) and precision (B, 2N, 2N) of statics, with the learnt correction."""
        learnt = torch.tanh(self.heads(torch.tanh(self.hidden(taut))))
        shift, widen = learnt.split([2 * self.segment_count, 1], dim=1)
        narrower = torch.exp(-2.0 * (widen + torch.log(self.spread.factor)))[..., None]
        deviation = (precision * self.identity).sum(2).sqrt().reciprocal()
        return torque_n_m + shift * deviation, precision * narrower
