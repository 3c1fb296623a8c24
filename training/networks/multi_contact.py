"""Several contacts at once: which segments are touched, and how hard, without directions."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor, nn

from cablesense_training.networks.layers import perceptron
from cablesense_training.networks.output import MultiContactOutput
from cablesense_training.networks.spread import Spread, StatedSpread
from cablesense_training.scaling import Standardiser


class MultiAnswer(NamedTuple):
    """Logits (B, N), magnitudes (B, N) and the hidden features (B, F) that tell their spread."""

    contact_logits: Tensor
    magnitude_n: Tensor
    features: Tensor


class MultiContactNetwork(nn.Module, ABC):
    """Raw tension differences in newtons in, `MultiContactOutput` in physical units out.

    Attributes:
        pose_aware: whether `forward` needs the commanded joint angles.
        magnitude: scaling of the force magnitudes in the loss.
        spread: head for the standard deviations of the magnitudes.
    """

    pose_aware: ClassVar[bool] = False
    spread: StatedSpread

    def __init__(self, cable_count: int, segment_count: int) -> None:
        super().__init__()
        self.cable_count = cable_count
        self.segment_count = segment_count
        self.magnitude = Standardiser(segment_count)

    @abstractmethod
    def adapt(self, tension_difference_n: Tensor, magnitude_n: Tensor) -> None:
        """Set the scaling from samples: tension differences (B, M) and magnitudes (B, N)."""

    @abstractmethod
    def forward(
        self, tension_difference_n: Tensor, joint_command_rad: Tensor | None = None
    ) -> MultiContactOutput:
        """Answers for tension differences (B, M) and, if pose-aware, joint commands (B, 2N)."""


class LearntMultiContactNetwork(MultiContactNetwork):
    """A network without physics in it; subclasses give `answer`.

    Attributes:
        tension: scaling of the M tension differences, in buffers that `adapt` sets.
    """

    spread: Spread

    def __init__(self, cable_count: int, segment_count: int, features: int) -> None:
        super().__init__(cable_count, segment_count)
        self.tension = Standardiser(cable_count)
        self.spread = Spread(features, outputs=segment_count)

    def adapt(self, tension_difference_n: Tensor, magnitude_n: Tensor) -> None:
        """Set the scaling from samples: tension differences (B, M) and magnitudes (B, N)."""
        self.tension.adapt(tension_difference_n)
        self.magnitude.adapt(magnitude_n)
        self.spread.unit.copy_(self.magnitude.std)

    @abstractmethod
    def answer(self, tension_difference_n: Tensor) -> MultiAnswer:
        """Contacts and magnitudes for raw tension differences (B, M)."""

    def forward(
        self, tension_difference_n: Tensor, joint_command_rad: Tensor | None = None
    ) -> MultiContactOutput:
        """Answers for tension differences (B, M); the commanded angles are not used."""
        answer = self.answer(tension_difference_n)
        std = self.spread(answer.features, tension_difference_n)
        return MultiContactOutput(answer.contact_logits, answer.magnitude_n, std)


class TwoStageMultiContactNetwork(LearntMultiContactNetwork):
    """The paper's network: a sigmoid per segment, whose verdict joins the input of stage two."""

    def __init__(
        self,
        cable_count: int,
        segment_count: int,
        contact_widths: Sequence[int] = (192, 192),
        widths: Sequence[int] = (192, 192, 192),
    ) -> None:
        super().__init__(cable_count, segment_count, features=widths[-1])
        self.contact_trunk = perceptron(cable_count, contact_widths)
        self.contact_head = nn.Linear(contact_widths[-1], segment_count)
        self.trunk = perceptron(cable_count + segment_count, widths)
        self.magnitude_head = nn.Linear(widths[-1], segment_count)

    def answer(self, tension_difference_n: Tensor) -> MultiAnswer:
        """See the base class."""
        x = self.tension(tension_difference_n)
        logits = self.contact_head(self.contact_trunk(x))
        touched = (logits > 0.0).to(x.dtype)
        hidden = self.trunk(torch.cat([x, touched], dim=-1))
        return MultiAnswer(logits, self.magnitude.undo(self.magnitude_head(hidden)), hidden)
