"""One backbone for all three tasks, with a linear head for each."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor, nn

from cablesense_training.networks.layers import perceptron
from cablesense_training.networks.single_contact import Answer, LearntNetwork


class SharedBackboneNetwork(LearntNetwork):
    """Contact, direction and magnitude are linear in the same hidden features."""

    def __init__(
        self, cable_count: int, segment_count: int, widths: Sequence[int] = (192, 192, 192)
    ) -> None:
        super().__init__(cable_count, segment_count, features=widths[-1])
        self.backbone = perceptron(cable_count, widths)
        self.contact_head = nn.Linear(widths[-1], segment_count + 1)
        self.direction_head = nn.Linear(widths[-1], 2)
        self.magnitude_head = nn.Linear(widths[-1], 1)

    def answer(self, tension_difference_n: Tensor, joint_command_rad: Tensor | None) -> Answer:
        """See the base class."""
        hidden = self.backbone(self.tension(tension_difference_n))
        return Answer(
            contact_logits=self.contact_head(hidden),
            direction=self.direction_head(hidden),
            magnitude_n=self.magnitude.undo(self.magnitude_head(hidden))[:, 0],
            features=hidden,
        )
