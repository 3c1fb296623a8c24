"""The paper's networks, which know nothing of the arm."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar, Self

import torch
from torch import Tensor, nn

from cablesense_sim.arm import Arm
from cablesense_training.networks.layers import (
    ContactNetwork,
    MultiContactOutput,
    SingleContactOutput,
    Standardiser,
    StatedSpread,
    one_hot_of_argmax,
    perceptron,
)


def tension_norm_n(tension_difference_n: Tensor) -> Tensor:
    """Length (B, 1) of the tension differences, kept off zero by 1 mN, so safe to divide by."""
    squared = (tension_difference_n * tension_difference_n).sum(dim=-1, keepdim=True)
    return torch.sqrt(squared + 1e-6)


class Spread(StatedSpread):
    """Standard deviations (B, outputs) from the answering network's hidden features, detached.

    The length of the tension difference joins them: sensor noise makes directions of weak forces
    uncertain as its inverse.
    """

    def __init__(self, features: int, outputs: int, width: int = 48) -> None:
        super().__init__(outputs)
        self.hidden = perceptron(features + 1, (width, width))
        self.log_std = nn.Linear(width, outputs)

    def forward(self, features: Tensor, tension_difference_n: Tensor) -> Tensor:
        """Standard deviations (B, outputs) from features (B, F) and tension differences (B, M)."""
        length = torch.log(tension_norm_n(tension_difference_n))
        hidden = self.hidden(torch.cat([features.detach(), length], dim=-1))
        log_std = self.log_std(hidden).clamp(-9.0, 6.0)
        return torch.exp(log_std) * self.factor


_Answer = tuple[Tensor, Tensor | None, Tensor, Tensor]
"""Contact logits, direction (B, 2) if any, magnitudes (B, 1 or N) in N, and hidden features."""


class LearntNetwork(ContactNetwork):
    """A network without physics in it; subclasses give `_answer`."""

    spread: Spread

    def __init__(self, cable_count: int, segment_count: int, features: int) -> None:
        super().__init__(cable_count, segment_count)
        self.tension = Standardiser(cable_count)
        self.spread = Spread(features, outputs=segment_count if self.several else 2)

    @classmethod
    def for_arm(cls, arm: Arm, tare_samples: int = 50) -> Self:
        """The network for an arm, whatever its tare."""
        return cls(arm.cable_count, arm.segment_count)  # type: ignore[call-arg]

    def adapt(self, tension_difference_n: Tensor, magnitude_n: Tensor) -> None:
        """See the base class."""
        self.tension.adapt(tension_difference_n)
        self.magnitude.adapt(magnitude_n.reshape(len(magnitude_n), -1))
        unit = self.magnitude.std
        units = unit if self.several else torch.cat([unit, unit.new_tensor([10])])
        self.spread.factor.copy_(units)

    @abstractmethod
    def _answer(self, tension_difference_n: Tensor) -> _Answer:
        """The answer to tension differences (B, M)."""

    def forward(
        self, tension_difference_n: Tensor, joint_command_rad: Tensor | None = None
    ) -> SingleContactOutput | MultiContactOutput:
        """See the base class; the commanded angles are not used."""
        logits, direction, magnitude_n, features = self._answer(tension_difference_n)
        std = self.spread(features, tension_difference_n)
        if direction is None:
            return MultiContactOutput(logits, magnitude_n, std)
        return SingleContactOutput(logits, direction, magnitude_n[:, 0], std[:, 0], std[:, 1])


class TwoStageNetwork(LearntNetwork):
    """First the contact, then magnitude and direction given the contact; equations (9) to (13).

    The contact's one-hot code joins the tension differences as input of the second trunk. It is
    the network's own verdict in training too, so stage two learns from mistakes of stage one.
    """

    usual_contact_widths: ClassVar[Sequence[int]] = (128, 128)

    def __init__(
        self,
        cable_count: int,
        segment_count: int,
        contact_widths: Sequence[int] = (),
        widths: Sequence[int] = (192, 192, 192),
    ) -> None:
        super().__init__(cable_count, segment_count, widths[-1])
        contact_widths = contact_widths or self.usual_contact_widths
        classes = segment_count if self.several else segment_count + 1
        self.contact_trunk = perceptron(cable_count, contact_widths)
        self.contact_head = nn.Linear(contact_widths[-1], classes)
        self.trunk = perceptron(cable_count + classes, widths)
        self.direction_head = None if self.several else nn.Linear(widths[-1], 2)
        self.magnitude_head = nn.Linear(widths[-1], segment_count if self.several else 1)

    def _answer(self, tension_difference_n: Tensor) -> _Answer:
        x = self.tension(tension_difference_n)
        logits = self.contact_head(self.contact_trunk(x))
        code = (logits > 0.0).to(x.dtype) if self.several else one_hot_of_argmax(logits)
        hidden = self.trunk(torch.cat([x, code], dim=-1))
        direction = None if self.direction_head is None else self.direction_head(hidden)
        return logits, direction, self.magnitude.undo(self.magnitude_head(hidden)), hidden


class TwoStageMultiContactNetwork(TwoStageNetwork):
    """The same for several contacts: a sigmoid per segment; no directions."""

    several: ClassVar[bool] = True
    usual_contact_widths: ClassVar[Sequence[int]] = (192, 192)


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

    def _answer(self, tension_difference_n: Tensor) -> _Answer:
        x = self.tension(tension_difference_n)
        for_direction = self.direction_trunk(x)
        for_magnitude = self.magnitude_trunk(x)
        return (
            self.contact_head(self.contact_trunk(x)),
            self.direction_head(for_direction),
            self.magnitude.undo(self.magnitude_head(for_magnitude)),
            torch.cat([for_direction, for_magnitude], dim=-1),
        )


class SharedBackboneNetwork(LearntNetwork):
    """Contact, direction and magnitude are linear in the same hidden features."""

    def __init__(
        self, cable_count: int, segment_count: int, widths: Sequence[int] = (192, 192, 192)
    ) -> None:
        super().__init__(cable_count, segment_count, widths[-1])
        self.trunk = perceptron(cable_count, widths)
        self.contact_head = nn.Linear(widths[-1], segment_count + 1)
        self.direction_head = nn.Linear(widths[-1], 2)
        self.magnitude_head = nn.Linear(widths[-1], 1)

    def _answer(self, tension_difference_n: Tensor) -> _Answer:
        hidden = self.trunk(self.tension(tension_difference_n))
        logits = self.contact_head(hidden)
        direction = self.direction_head(hidden)
        return logits, direction, self.magnitude.undo(self.magnitude_head(hidden)), hidden
