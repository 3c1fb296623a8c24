"""A contact anywhere on the arm: the torques that tensions show, and those that contacts make.

Statics gives the torques of the environment on the joints and those of unit forces on every
segment (`cablesense_sim.contact_location.TorqueBalance`). The posterior of place and force follows
from them outside the graph (`inference.anywhere`). Nothing is learnt but a factor of the stated
deviations.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from cablesense_training.networks.closed_form import ClosedForm
from cablesense_training.networks.layers import StatedSpread
from cablesense_training.networks.statics import StaticsNetwork


class ContactBalance(NamedTuple):
    """The model's outputs for B samples: a part of `Balance`, with residuals for `missing_m`.

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


class AnywhereStatics(StaticsNetwork):
    """The balance of tension differences (B, M) at joint commands (B, 2N)."""

    def __init__(self, closed_form: ClosedForm) -> None:
        super().__init__(closed_form)
        self.spread = StatedSpread(1)
        self.double()

    def forward(
        self, tension_difference_n: Tensor, joint_command_rad: Tensor | None = None
    ) -> ContactBalance:
        """See the base class; the commanded angles are needed."""
        found = self.balance(tension_difference_n, joint_command_rad)
        jacobian, variance_n2 = found.jacobian_t_m, self.closed_form.reading_variance_n2
        # variance of a cable's tension in the pose, over that of a reading
        leverage = variance_n2 * (jacobian * (found.precision @ jacobian)).sum(1)
        known_n = torch.sqrt(variance_n2 * (1.0 + (1.0 - found.taut) * leverage))
        residual = found.missing_m / (self.closed_form.compliance_m_n * known_n)
        precision = found.precision * self.spread.factor**-2
        return ContactBalance(found.torque_n_m, precision, *found[2:5], residual, found.taut)
