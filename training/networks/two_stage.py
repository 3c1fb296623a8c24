"""The two-stage network of the paper, with no contact as a class of its own."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from cablesense_training.networks.layers import one_hot_of_argmax, perceptron
from cablesense_training.networks.single_contact import Answer, LearntNetwork


class TwoStageNetwork(LearntNetwork):
    """First the contact, then magnitude and direction given the contact; equations (9) to (13).

    With x the standardised tension differences, stage one gives the contact class, whose one-hot
    code c joins x as input of the trunk φ that magnitude and direction share. In training, too, c
    is the network's own verdict, so stage two learns from the mistakes that stage one makes in
    use.
    """

    def __init__(
        self,
        cable_count: int,
        segment_count: int,
        contact_widths: Sequence[int] = (128, 128),
        widths: Sequence[int] = (192, 192, 192),
    ) -> None:
        super().__init__(cable_count, segment_count, features=widths[-1])
        classes = segment_count + 1
        self.contact_trunk = perceptron(cable_count, contact_widths)
        self.contact_head = nn.Linear(contact_widths[-1], classes)
        self.trunk = perceptron(cable_count + classes, widths)
        self.direction_head = nn.Linear(widths[-1], 2)
        self.magnitude_head = nn.Linear(widths[-1], 1)

    def answer(self, tension_difference_n: Tensor, joint_command_rad: Tensor | None) -> Answer:
        """See the base class."""
        x = self.tension(tension_difference_n)
        logits = self.contact_head(self.contact_trunk(x))
        contact = one_hot_of_argmax(logits)
        hidden = self.trunk(torch.cat([x, contact], dim=-1))
        return Answer(
            contact_logits=logits,
            direction=self.direction_head(hidden),
            magnitude_n=self.magnitude.undo(self.magnitude_head(hidden))[:, 0],
            features=hidden,
        )
