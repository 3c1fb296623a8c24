"""Building blocks of the networks, and their answers in physical units.

Inputs and labels are standardised inside the networks. The stated uncertainty is a small separate
head that cannot disturb the answers.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor, nn


def perceptron(inputs: int, widths: Sequence[int]) -> nn.Sequential:
    """Fully connected hidden layers of the given widths, each followed by a SiLU."""
    layers: list[nn.Module] = []
    for width in widths:
        layers += [nn.Linear(inputs, width), nn.SiLU()]
        inputs = width
    return nn.Sequential(*layers)


def one_hot_of_argmax(logits: Tensor) -> Tensor:
    """One-hot code (B, K) of the likeliest class, equation (10); no gradient passes through it."""
    winner = logits.argmax(dim=-1, keepdim=True)
    classes = torch.arange(logits.shape[-1], device=logits.device)
    return (classes == winner).to(logits.dtype)


class SingleContactOutput(NamedTuple):
    """Answer for B tension differences of an arm with N segments.

    Attributes:
        contact_logits: (B, N + 1) no contact, segment 1 … N; their softmax is the contact
            probability.
        direction: (B, 2) (sin θ, cos θ) of the contact angle, not necessarily of unit length.
        magnitude_n: (B,) force magnitude.
        magnitude_std_n: (B,) stated standard deviation of the magnitude.
        angle_std_deg: (B,) stated standard deviation of the contact angle.
    """

    contact_logits: Tensor
    direction: Tensor
    magnitude_n: Tensor
    magnitude_std_n: Tensor
    angle_std_deg: Tensor


class MultiContactOutput(NamedTuple):
    """Answer for B tension differences, each segment of N touched or not.

    Attributes:
        contact_logits: (B, N) their sigmoid is the probability that a segment is touched.
        magnitude_n: (B, N) force magnitudes, meant where the segment is touched.
        magnitude_std_n: (B, N) stated standard deviations of the magnitudes.
    """

    contact_logits: Tensor
    magnitude_n: Tensor
    magnitude_std_n: Tensor


class StatedSpread(nn.Module):
    """Common to every head for stated standard deviations.

    Attributes:
        factor: (outputs,) in which they are counted; set after training such that 95 % of held-out
            errors lie within 1.96 standard deviations.
    """

    factor: Tensor

    def __init__(self, outputs: int) -> None:
        super().__init__()
        self.register_buffer("factor", torch.ones(outputs))


class Standardiser(nn.Module):
    """`(x - mean) / std` per column, and back; `adapt` sets these buffers from training data."""

    mean: Tensor
    std: Tensor

    def __init__(self, columns: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(columns))
        self.register_buffer("std", torch.ones(columns))

    def adapt(self, values: Tensor) -> None:
        """Take mean and standard deviation from rows (B, columns); a constant is not scaled."""
        std = values.std(dim=0, correction=0)
        self.mean.copy_(values.mean(dim=0))
        # not above zero: a constant would be divided by its rounding error
        self.std.copy_(std.where(std > 1e-9, 1.0))

    def forward(self, values: Tensor) -> Tensor:
        """Standardised rows (B, columns)."""
        return (values - self.mean) / self.std

    def undo(self, values: Tensor) -> Tensor:
        """Rows in physical units from standardised ones."""
        return values * self.std + self.mean


class ContactNetwork(nn.Module, ABC):
    """Raw tension differences in newtons in, contacts in physical units out.

    Attributes:
        several: whether any number of segments may be touched at once, or one at most.
        pose_aware: whether `forward` needs the commanded joint angles.
        magnitude: scaling of the force magnitudes in the loss.
        spread: head for the stated standard deviations: of the N magnitudes, or of (magnitude,
            N; angle, degrees).
    """

    several: ClassVar[bool] = False
    pose_aware: ClassVar[bool] = False
    spread: StatedSpread

    def __init__(self, cable_count: int, segment_count: int) -> None:
        super().__init__()
        self.cable_count = cable_count
        self.segment_count = segment_count
        self.magnitude = Standardiser(segment_count if self.several else 1)

    @abstractmethod
    def adapt(self, tension_difference_n: Tensor, magnitude_n: Tensor) -> None:
        """Set the scaling from training samples: tension differences (B, M), magnitudes (B, …)."""

    @abstractmethod
    def forward(
        self, tension_difference_n: Tensor, joint_command_rad: Tensor | None = None
    ) -> Any:
        """A `MultiContactOutput` if `several`, else a `SingleContactOutput`.

        It is for tension differences (B, M) and, if pose-aware, joint commands (B, 2N).
        """
