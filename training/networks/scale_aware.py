"""A network for the twelve tensions alone that knows how tensions scale with force."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from cablesense_training.networks.layers import gated_perceptron, tension_norm_n
from cablesense_training.networks.single_contact import Answer, LearntNetwork


class ScaleAwareNetwork(LearntNetwork):
    """Reads the pattern of the tension differences apart from their size.

    While no cable goes slack, twice the force makes twice the differences: the pattern
    u = ΔT / |ΔT| holds segment and direction, and the magnitude is |ΔT| times a function of it.
    Pattern, log |ΔT| and the standardised differences (slack and sensor noise do depend on size)
    enter one trunk of gated layers; the magnitude's head answers the logarithm of F / |ΔT|, so
    its error is relative, as the physics is.
    """

    def __init__(
        self, cable_count: int, segment_count: int, widths: Sequence[int] = (208, 208, 208)
    ) -> None:
        super().__init__(cable_count, segment_count, features=widths[-1])
        self.trunk = gated_perceptron(2 * cable_count + 1, widths)
        self.contact_head = nn.Linear(widths[-1], segment_count + 1)
        self.direction_head = nn.Linear(widths[-1], 2)
        self.ratio_head = nn.Linear(widths[-1], 1)

    def answer(self, tension_difference_n: Tensor, joint_command_rad: Tensor | None) -> Answer:
        """See the base class."""
        length = tension_norm_n(tension_difference_n)
        pattern = tension_difference_n / length
        x = torch.cat(
            [pattern, torch.log(length) / 3.0, self.tension(tension_difference_n)], dim=-1
        )
        hidden = self.trunk(x)
        ratio = torch.exp(self.ratio_head(hidden).clamp(max=3.0))
        return Answer(
            contact_logits=self.contact_head(hidden),
            direction=self.direction_head(hidden),
            magnitude_n=(length * ratio)[:, 0],
            features=hidden,
        )
