"""What all single-contact networks have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor, nn

from cablesense_training.networks.output import SingleContactOutput
from cablesense_training.networks.spread import Spread, StatedSpread
from cablesense_training.scaling import Standardiser


class Answer(NamedTuple):
    """A network's answer before its uncertainty is stated.

    Attributes:
        contact_logits: (B, N + 1).
        direction: (B, 2).
        magnitude_n: (B,).
        features: (B, F) hidden features that the uncertainty is read from.
    """

    contact_logits: Tensor
    direction: Tensor
    magnitude_n: Tensor
    features: Tensor


class SingleContactNetwork(nn.Module, ABC):
    """Raw tension differences in newtons in, `SingleContactOutput` in physical units out.

    Attributes:
        pose_aware: whether `forward` needs the commanded joint angles.
        magnitude: scaling of the force magnitude in the loss.
        spread: head for the standard deviations of (magnitude, N; angle, degrees).
    """

    pose_aware: ClassVar[bool] = False
    spread: StatedSpread

    def __init__(self, cable_count: int, segment_count: int) -> None:
        super().__init__()
        self.cable_count = cable_count
        self.segment_count = segment_count
        self.magnitude = Standardiser(1)

    @abstractmethod
    def adapt(self, tension_difference_n: Tensor, magnitude_n: Tensor) -> None:
        """Set the scaling from training samples: tension differences (B, M), magnitudes (B,)."""

    @abstractmethod
    def forward(
        self, tension_difference_n: Tensor, joint_command_rad: Tensor | None = None
    ) -> SingleContactOutput:
        """Answers for tension differences (B, M) and, if pose-aware, joint commands (B, 2N)."""


class LearntNetwork(SingleContactNetwork):
    """A network without physics in it; subclasses give `answer`.

    Attributes:
        tension: scaling of the M tension differences, in buffers that `adapt` sets.
    """

    spread: Spread

    def __init__(self, cable_count: int, segment_count: int, features: int) -> None:
        super().__init__(cable_count, segment_count)
        self.tension = Standardiser(cable_count)
        self.spread = Spread(features, outputs=2)

    def adapt(self, tension_difference_n: Tensor, magnitude_n: Tensor) -> None:
        """Set the scaling from samples: tension differences (B, M) and magnitudes (B,)."""
        self.tension.adapt(tension_difference_n)
        self.magnitude.adapt(magnitude_n[:, None])
        self.spread.unit.copy_(
            torch.stack([self.magnitude.std[0], self.spread.unit.new_tensor(10.0)])
        )

    @abstractmethod
    def answer(self, tension_difference_n: Tensor, joint_command_rad: Tensor | None) -> Answer:
        """Contact, direction and magnitude for raw tension differences (B, M)."""

    def forward(
        self, tension_difference_n: Tensor, joint_command_rad: Tensor | None = None
    ) -> SingleContactOutput:
        """Answers for tension differences (B, M); if `pose_aware`, of commanded angles (B, 2N)."""
        answer = self.answer(tension_difference_n, joint_command_rad)
        std = self.spread(answer.features, tension_difference_n)
        return SingleContactOutput(
            contact_logits=answer.contact_logits,
            direction=answer.direction,
            magnitude_n=answer.magnitude_n,
            magnitude_std_n=std[:, 0],
            angle_std_deg=std[:, 1],
        )
