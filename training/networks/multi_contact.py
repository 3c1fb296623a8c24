"""Several contacts at once: which segments are touched, and how hard, without directions.

By a learnt network, or by statics: all segments' forces in one fit, then of those touched.

N segments with two force components each are 2N unknowns for 2N joint torques: solvable, without
redundancy. A segment is touched where its force is too large for its own uncertainty. Leaving the
untouched ones out gives the redundancy back, so the second fit, over the touched segments alone,
gives their forces more precisely.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import torch
from torch import Tensor, nn

from cablesense_sim.arm import Arm
from cablesense_training.networks.closed_form import ClosedForm, inverse, own_blocks
from cablesense_training.networks.corrected import exact_statics
from cablesense_training.networks.layers import (
    ContactNetwork,
    MultiContactOutput,
    Spread,
    Standardiser,
    StatedSpread,
    perceptron,
)


class MultiContactNetwork(ContactNetwork[MultiContactOutput]):
    """Any number of contacts; `spread` states the deviations of the N magnitudes."""

    def __init__(self, cable_count: int, segment_count: int) -> None:
        super().__init__(cable_count, segment_count, magnitudes=segment_count)


class TwoStageMultiContactNetwork(MultiContactNetwork):
    """The paper's network: a sigmoid per segment, whose decision joins the input of stage two."""

    spread: Spread

    def __init__(
        self,
        cable_count: int,
        segment_count: int,
        contact_widths: Sequence[int] = (192, 192),
        widths: Sequence[int] = (192, 192, 192),
    ) -> None:
        super().__init__(cable_count, segment_count)
        self.tension = Standardiser(cable_count)
        self.spread = Spread(widths[-1], outputs=segment_count)
        self.contact_trunk = perceptron(cable_count, contact_widths)
        self.contact_head = nn.Linear(contact_widths[-1], segment_count)
        self.trunk = perceptron(cable_count + segment_count, widths)
        self.magnitude_head = nn.Linear(widths[-1], segment_count)

    @classmethod
    def for_arm(cls, arm: Arm, tare_samples: int = 50) -> TwoStageMultiContactNetwork:
        """The network for an arm, whatever its tare."""
        return cls(arm.cable_count, arm.segment_count)

    def adapt(self, tension_difference_n: Tensor, magnitude_n: Tensor) -> None:
        """Set the scaling from samples: tension differences (B, M) and magnitudes (B, N)."""
        self.tension.adapt(tension_difference_n)
        self.magnitude.adapt(magnitude_n)
        self.spread.unit.copy_(self.magnitude.std)

    def forward(
        self, tension_difference_n: Tensor, joint_command_rad: Tensor | None = None
    ) -> MultiContactOutput:
        """Answers for tension differences (B, M); the commanded angles are not used."""
        x = self.tension(tension_difference_n)
        logits = self.contact_head(self.contact_trunk(x))
        touched = (logits > 0.0).to(x.dtype)
        hidden = self.trunk(torch.cat([x, touched], dim=-1))
        magnitude = self.magnitude.undo(self.magnitude_head(hidden))
        return MultiContactOutput(logits, magnitude, self.spread(hidden, tension_difference_n))


UNTOUCHED_PRECISION = 1e6
"""Information, 1/N², that an untouched segment's force is zero: it cannot exceed a millinewton."""

_FORCE_SCALE_N = 60.0
_WEAKEST_N = 1e-3


class MultiContactClosedForm(MultiContactNetwork):
    """Contacts and magnitudes for tension differences (B, M) and joint commands (B, 2N), float64.

    Args:
        closed_form: statics of the arm.
    """

    pose_aware: ClassVar[bool] = True

    def __init__(self, closed_form: ClosedForm, width: int = 32) -> None:
        cables = closed_form.kinematics.cable_count
        segments = closed_form.kinematics.segment_count
        super().__init__(cables, segments)
        self.spread = StatedSpread(segments)
        self.closed_form = closed_form
        self.trust = nn.Parameter(torch.full((segments,), 0.5))
        self.bias = nn.Parameter(torch.full((segments,), -6.0))
        self.widen = perceptron(2 * segments + cables, (width,))
        self.log_widen = nn.Linear(width, segments)
        nn.init.zeros_(self.log_widen.weight)
        nn.init.zeros_(self.log_widen.bias)
        self.double()

    @classmethod
    def for_arm(cls, arm: Arm, tare_samples: int = 50) -> MultiContactClosedForm:
        """The network of an arm, its sensors, and a tare averaged over `tare_samples` readings."""
        return cls(exact_statics(arm, tare_samples))

    def adapt(self, tension_difference_n: Tensor, magnitude_n: Tensor) -> None:
        """Only the loss needs a scale, and counts magnitudes in the sensors' own noise."""
        self.magnitude.std.fill_(self.closed_form.reading_variance_n2**0.5)

    def forward(
        self, tension_difference_n: Tensor, joint_command_rad: Tensor | None = None
    ) -> MultiContactOutput:
        """See the base class; the commanded angles are needed."""
        assert joint_command_rad is not None
        n = self.segment_count
        balance = self.closed_form.balance(
            tension_difference_n.double(), joint_command_rad.double()
        )
        lever = balance.lever.reshape(-1, 2 * n, 2 * n)
        weighted = lever @ balance.precision
        information = weighted @ lever.transpose(1, 2)
        pull = weighted @ balance.torque_n_m
        covariance = inverse(information)
        # chi² of each segment's own two components, the others unknown
        together = covariance @ pull
        own, pairs = own_blocks(covariance, n), together.reshape(-1, n, 2, 1)
        significance = (pairs * (inverse(own) @ pairs)).sum((2, 3))
        logits = self.trust * significance + self.bias
        touched = (logits > 0.0).to(pull.dtype)
        held = ((1.0 - touched) * UNTOUCHED_PRECISION)[:, :, None].expand(-1, -1, 2)
        covariance = inverse(information + torch.diag_embed(held.reshape(-1, 2 * n)))
        force = (covariance @ pull).reshape(-1, n, 2)
        magnitude = torch.sqrt((force * force).sum(-1) + _WEAKEST_N**2)
        radial = (force / magnitude[..., None])[..., None]
        variance = (radial * (own_blocks(covariance, n) @ radial)).sum((2, 3))
        std = torch.sqrt(variance.clamp(min=0.0) + 1e-6)
        features = [magnitude / _FORCE_SCALE_N, touched, balance.taut]
        hidden = self.widen(torch.cat(features, dim=-1).detach())
        scale = torch.exp(torch.tanh(self.log_widen(hidden)))
        return MultiContactOutput(logits, magnitude, std.detach() * scale * self.spread.factor)
