"""The decoupled baseline: one network for each of contact, direction and magnitude."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from cablesense_training.networks.layers import perceptron
from cablesense_training.networks.single_contact import Answer, LearntNetwork


class DecoupledNetwork(LearntNetwork):
    """Three networks that share nothing but the standardised input."""

    def __init__(
        self, cable_count: int, segment_count: int, widths: Sequence[int] = (128, 128, 128)
    ) -> None:
        super().__init__(cable_count, segment_count, features=2 * widths[-1])
        self.contact_trunk = perceptron(cable_count, widths)
        self.contact_head = nn.Linear(widths[-1], segment_count + 1)
        self.direction_trunk = perceptron(cable_count, widths)
        self.direction_head = nn.Linear(widths[-1], 2)
        self.magnitude_trunk = perceptron(cable_count, widths)
        self.magnitude_head = nn.Linear(widths[-1], 1)

    def answer(self, tension_difference_n: Tensor, joint_command_rad: Tensor | None) -> Answer:
        """See the base class."""
        x = self.tension(tension_difference_n)
        for_direction, for_magnitude = self.direction_trunk(x), self.magnitude_trunk(x)
        magnitude = self.magnitude.undo(self.magnitude_head(for_magnitude))
        return Answer(
            contact_logits=self.contact_head(self.contact_trunk(x)),
            direction=self.direction_head(for_direction),
            magnitude_n=magnitude[:, 0],
            features=torch.cat([for_direction, for_magnitude], dim=-1),
        )
