"""Building blocks of the networks, and their answers in physical units.

Inputs and labels are standardised inside the networks. The stated uncertainty is a small separate
head that cannot disturb the answers.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, Generic, NamedTuple, TypeVar

import torch
from torch import Tensor, nn
from torch.nn import functional


def perceptron(inputs: int, widths: Sequence[int]) -> nn.Sequential:
    """Fully connected hidden layers of the given widths, each followed by a SiLU."""
    layers: list[nn.Module] = []
    for width in widths:
        layers += [nn.Linear(inputs, width), nn.SiLU()]
        inputs = width
    return nn.Sequential(*layers)


class GatedLayer(nn.Module):
    """SiLU(W x + a) times (V x + b), elementwise: a layer that can multiply its inputs.

    An unknown pose changes tensions by a product of angles and forces, which a plain layer can
    only approximate. Shazeer, GLU Variants Improve Transformer, 2020 (there: SwiGLU).
    """

    def __init__(self, inputs: int, width: int) -> None:
        super().__init__()
        self.gate = nn.Linear(inputs, width)
        self.value = nn.Linear(inputs, width)

    def forward(self, x: Tensor) -> Tensor:
        """Features (B, width) of inputs (B, inputs)."""
        return functional.silu(self.gate(x)) * self.value(x)


def one_hot_of_argmax(logits: Tensor) -> Tensor:
    """One-hot code (B, K) of the likeliest class, equation (10); no gradient passes through it."""
    winner = logits.argmax(dim=-1, keepdim=True)
    classes = torch.arange(logits.shape[-1], device=logits.device)
    return (classes == winner).to(logits.dtype)


def tension_norm_n(tension_difference_n: Tensor) -> Tensor:
    """Length (B, 1) of the tension differences, kept off zero by 1 mN, so safe to divide by."""
    squared = (tension_difference_n * tension_difference_n).sum(dim=-1, keepdim=True)
    return torch.sqrt(squared + 1e-6)


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
        factor: (outputs,) set after training such that 95 % of held-out errors lie within 1.96
            standard deviations.
    """

    factor: Tensor

    def __init__(self, outputs: int) -> None:
        super().__init__()
        self.register_buffer("factor", torch.ones(outputs))


class Spread(StatedSpread):
    """Standard deviations (B, outputs) from the answering network's hidden features.

    The features arrive detached, so the likelihood that trains this head leaves the answers
    alone. The length of the tension difference joins them, because sensor noise makes directions
    of weak forces uncertain as its inverse. The likelihood alone does not make 95 % intervals
    hold where errors have heavy tails; `factor` does.
    """

    unit: Tensor

    def __init__(self, features: int, outputs: int, width: int = 48) -> None:
        super().__init__(outputs)
        self.hidden = perceptron(features + 1, (width, width))
        self.log_std = nn.Linear(width, outputs)
        self.register_buffer("unit", torch.ones(outputs))

    def forward(self, features: Tensor, tension_difference_n: Tensor) -> Tensor:
        """Standard deviations (B, outputs) from features (B, F) and tension differences (B, M)."""
        length = torch.log(tension_norm_n(tension_difference_n))
        hidden = self.hidden(torch.cat([features.detach(), length], dim=-1))
        log_std = self.log_std(hidden).clamp(-9.0, 6.0)
        std: Tensor = torch.exp(log_std) * self.unit * self.factor
        return std


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
        scaled: Tensor = (values - self.mean) / self.std
        return scaled

    def undo(self, values: Tensor) -> Tensor:
        """Rows in physical units from standardised ones."""
        physical: Tensor = values * self.std + self.mean
        return physical


Output = TypeVar("Output", SingleContactOutput, MultiContactOutput)


class ContactNetwork(nn.Module, ABC, Generic[Output]):
    """Raw tension differences in newtons in, contacts in physical units out.

    Attributes:
        pose_aware: whether `forward` needs the commanded joint angles.
        magnitude: scaling of the force magnitudes in the loss.
        spread: head for the stated standard deviations.
    """

    pose_aware: ClassVar[bool] = False
    spread: StatedSpread

    def __init__(self, cable_count: int, segment_count: int, magnitudes: int) -> None:
        super().__init__()
        self.cable_count = cable_count
        self.segment_count = segment_count
        self.magnitude = Standardiser(magnitudes)

    @abstractmethod
    def adapt(self, tension_difference_n: Tensor, magnitude_n: Tensor) -> None:
        """Set the scaling from training samples: tension differences (B, M), magnitudes (B, …)."""

    @abstractmethod
    def forward(
        self, tension_difference_n: Tensor, joint_command_rad: Tensor | None = None
    ) -> Output:
        """Answers for tension differences (B, M) and, if pose-aware, joint commands (B, 2N)."""
