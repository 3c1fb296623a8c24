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
from cablesense_training.networks.closed_form import ClosedForm
from cablesense_training.networks.layers import ContactNetwork, StatedSpread
from cablesense_training.networks.statics import statics

_WIDTH = 32


class ContactBalance(NamedTuple):
    """What the model gives for B samples: a part of `Balance`, with residuals for `missing_m`.

    Attributes:
        residual: (B, M) readings minus the tensions of the pose, in standard deviations.
    """

    torque_n_m: Tensor
    precision: Tensor
    by_force_m: Tensor
    by_place: Tensor
    by_twist: Tensor
    residual: Tensor
    taut: Tensor


class AnywhereStatics(ContactNetwork):
    """The balance of tension differences (B, M) at joint commands (B, 2N), in float64.

    Args:
        closed_form: statics of the arm.
    """

    pose_aware: ClassVar[bool] = True
    identity: Tensor

    def __init__(self, closed_form: ClosedForm) -> None:
        segments = closed_form.kinematics.segment_count
        super().__init__(closed_form.kinematics.cable_count, segments)
        self.closed_form = closed_form
        self.spread = StatedSpread(1)
        self.hidden = nn.Linear(self.cable_count, _WIDTH)
        self.heads = nn.Linear(_WIDTH, 2 * segments + 1, bias=False)
        nn.init.zeros_(self.heads.weight)
        self.register_buffer("identity", torch.eye(2 * segments))
        self.double()

    @classmethod
    def for_arm(cls, arm: Arm, tare_samples: int = 50) -> AnywhereStatics:
        """The network of an arm, its sensors, and a tare averaged over `tare_samples` readings."""
        return cls(statics(arm, tare_samples))

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
        found = self.closed_form(tension_difference_n.double(), joint_command_rad.double())
        jacobian, variance_n2 = found.jacobian_t_m, self.closed_form.reading_variance_n2
        # variance of a cable's tension in the pose, over that of a reading
        leverage = variance_n2 * (jacobian * (found.precision @ jacobian)).sum(1)
        known_n = torch.sqrt(variance_n2 * (1.0 + (1.0 - found.taut) * leverage))
        residual = found.missing_m / (self.closed_form.compliance_m_n * known_n)
        return ContactBalance(*found[:5], residual, found.taut)

    def corrected(
        self, torque_n_m: Tensor, precision: Tensor, taut: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Torques (B, 2N) and precision (B, 2N, 2N) of statics, with the learnt correction."""
        learnt = torch.tanh(self.heads(torch.tanh(self.hidden(taut))))
        shift, widen = learnt.split([2 * self.segment_count, 1], dim=1)
        narrower = torch.exp(-2.0 * (widen + torch.log(self.spread.factor)))[..., None]
        deviation = (precision * self.identity).sum(2).sqrt().reciprocal()
        return torque_n_m + shift * deviation, precision * narrower
