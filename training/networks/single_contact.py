"""Single-contact networks: their common base, the paper's three designs and a scale-aware one.

All of them have a class for no contact.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from itertools import pairwise
from typing import Self

import torch
from torch import Tensor, nn

from cablesense_sim.arm import Arm
from cablesense_training.networks.layers import (
    ContactNetwork,
    GatedLayer,
    SingleContactOutput,
    Spread,
    Standardiser,
    one_hot_of_argmax,
    perceptron,
    tension_norm_n,
)


class SingleContactNetwork(ContactNetwork[SingleContactOutput]):
    """One contact; `spread` states the deviations of (magnitude, N; angle, degrees)."""

    def __init__(self, cable_count: int, segment_count: int) -> None:
        super().__init__(cable_count, segment_count, magnitudes=1)


class LearntNetwork(SingleContactNetwork):
    """A network without physics in it; subclasses give `_answer`.

    Attributes:
        tension: scaling of the M tension differences, in buffers that `adapt` sets.
    """

    spread: Spread

    def __init__(self, cable_count: int, segment_count: int, features: int = 192) -> None:
        super().__init__(cable_count, segment_count)
        self.tension = Standardiser(cable_count)
        self.spread = Spread(features, outputs=2)

    @classmethod
    def for_arm(cls, arm: Arm, tare_samples: int = 50) -> Self:
        """The network for an arm, whatever its tare."""
        return cls(arm.cable_count, arm.segment_count)

    def adapt(self, tension_difference_n: Tensor, magnitude_n: Tensor) -> None:
        """Set the scaling from samples: tension differences (B, M) and magnitudes (B,)."""
        self.tension.adapt(tension_difference_n)
        self.magnitude.adapt(magnitude_n[:, None])
        self.spread.unit.copy_(
            torch.stack([self.magnitude.std[0], self.spread.unit.new_tensor(10.0)])
        )

    @abstractmethod
    def _answer(self, tension_difference_n: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Contact logits (B, N + 1), direction (B, 2), magnitude (B,), N, and hidden features."""

    def forward(
        self, tension_difference_n: Tensor, joint_command_rad: Tensor | None = None
    ) -> SingleContactOutput:
        """Answers for tension differences (B, M); the commanded angles are not used."""
        logits, direction, magnitude_n, features = self._answer(tension_difference_n)
        std = self.spread(features, tension_difference_n)
        return SingleContactOutput(logits, direction, magnitude_n, std[:, 0], std[:, 1])


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
        super().__init__(cable_count, segment_count, widths[-1])
        classes = segment_count + 1
        self.contact_trunk = perceptron(cable_count, contact_widths)
        self.contact_head = nn.Linear(contact_widths[-1], classes)
        self.trunk = perceptron(cable_count + classes, widths)
        self.direction_head = nn.Linear(widths[-1], 2)
        self.magnitude_head = nn.Linear(widths[-1], 1)

    def _answer(self, tension_difference_n: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        x = self.tension(tension_difference_n)
        logits = self.contact_head(self.contact_trunk(x))
        hidden = self.trunk(torch.cat([x, one_hot_of_argmax(logits)], dim=-1))
        direction = self.direction_head(hidden)
        return logits, direction, self.magnitude.undo(self.magnitude_head(hidden))[:, 0], hidden


class DecoupledNetwork(LearntNetwork):
    """Three networks that share nothing but the standardised input."""

    def __init__(
        self, cable_count: int, segment_count: int, widths: Sequence[int] = (128, 128, 128)
    ) -> None:
        super().__init__(cable_count, segment_count, 2 * widths[-1])
        self.contact_trunk = perceptron(cable_count, widths)
        self.contact_head = nn.Linear(widths[-1], segment_count + 1)
        self.direction_trunk = perceptron(cable_count, widths)
        self.direction_head = nn.Linear(widths[-1], 2)
        self.magnitude_trunk = perceptron(cable_count, widths)
        self.magnitude_head = nn.Linear(widths[-1], 1)

    def _answer(self, tension_difference_n: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        x = self.tension(tension_difference_n)
        for_direction, for_magnitude = self.direction_trunk(x), self.magnitude_trunk(x)
        magnitude = self.magnitude.undo(self.magnitude_head(for_magnitude))
        logits = self.contact_head(self.contact_trunk(x))
        direction = self.direction_head(for_direction)
        magnitude_n = magnitude[:, 0]
        return logits, direction, magnitude_n, torch.cat([for_direction, for_magnitude], dim=-1)


class SharedBackboneNetwork(LearntNetwork):
    """Contact, direction and magnitude are linear in the same hidden features."""

    def __init__(
        self, cable_count: int, segment_count: int, widths: Sequence[int] = (192, 192, 192)
    ) -> None:
        super().__init__(cable_count, segment_count, widths[-1])
        self.backbone = perceptron(cable_count, widths)
        self.contact_head = nn.Linear(widths[-1], segment_count + 1)
        self.direction_head = nn.Linear(widths[-1], 2)
        self.magnitude_head = nn.Linear(widths[-1], 1)

    def _answer(self, tension_difference_n: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        hidden = self.backbone(self.tension(tension_difference_n))
        logits, direction = self.contact_head(hidden), self.direction_head(hidden)
        return logits, direction, self.magnitude.undo(self.magnitude_head(hidden))[:, 0], hidden


class ScaleAwareNetwork(LearntNetwork):
    """Separates the pattern of the tension differences from their size.

    While no cable goes slack, twice the force makes twice the differences: the pattern
    u = ΔT / |ΔT| holds segment and direction, and the magnitude is |ΔT| times a function of it.
    Pattern, log |ΔT| and the standardised differences (slack and sensor noise do depend on size)
    enter one trunk of gated layers; the magnitude's head answers the logarithm of F / |ΔT|, so
    its error is relative, as the physics is.
    """

    def __init__(
        self, cable_count: int, segment_count: int, widths: Sequence[int] = (208, 208, 208)
    ) -> None:
        super().__init__(cable_count, segment_count, widths[-1])
        sizes = pairwise([2 * cable_count + 1, *widths])
        self.trunk = nn.Sequential(*(GatedLayer(inputs, width) for inputs, width in sizes))
        self.contact_head = nn.Linear(widths[-1], segment_count + 1)
        self.direction_head = nn.Linear(widths[-1], 2)
        self.ratio_head = nn.Linear(widths[-1], 1)

    def _answer(self, tension_difference_n: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        length = tension_norm_n(tension_difference_n)
        pattern = tension_difference_n / length
        x = torch.cat(
            [pattern, torch.log(length) / 3.0, self.tension(tension_difference_n)], dim=-1
        )
        hidden = self.trunk(x)
        ratio = torch.exp(self.ratio_head(hidden).clamp(max=3.0))
        logits, direction = self.contact_head(hidden), self.direction_head(hidden)
        return logits, direction, (length * ratio)[:, 0], hidden
