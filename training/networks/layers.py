"""Common to the networks: building blocks, answers in physical units, and their losses.

Inputs and labels are standardised inside the networks. The stated uncertainty is a small separate
head that cannot disturb the answers. Losses (4) to (8) are those of the paper.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

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


def one_hot_of_argmax(logits: Tensor) -> Tensor:
    """One-hot code (B, K) of the likeliest class, equation (10); no gradient passes through it."""
    winner = logits.argmax(dim=-1, keepdim=True)
    classes = torch.arange(logits.shape[-1], device=logits.device)
    return (classes == winner).to(logits.dtype)


class SingleContactOutput(NamedTuple):
    """Answer for B tension differences of an arm with N segments.

    Attributes:
        contact_logits: (B, N + 1) no contact, segment 1 … N.
        direction: (B, 2) (sin θ, cos θ) of the contact angle, not necessarily of unit length.
        magnitude_n, magnitude_std_n, angle_std_deg: (B,) with stated standard deviations.
    """

    contact_logits: Tensor
    direction: Tensor
    magnitude_n: Tensor
    magnitude_std_n: Tensor
    angle_std_deg: Tensor


class MultiContactOutput(NamedTuple):
    """Answer for B tension differences, all (B, N): the sigmoid of a logit is that of a contact.

    Magnitudes are meant where the segment is touched.
    """

    contact_logits: Tensor
    magnitude_n: Tensor
    magnitude_std_n: Tensor


class StatedSpread(nn.Module):
    """Common to every head for stated standard deviations."""

    def __init__(self, outputs: int) -> None:
        super().__init__()
        # in which they are counted, so that 95 % of held-out errors lie within 1.96 of them
        self.factor: Tensor = nn.Buffer(torch.ones(outputs))


class Standardiser(nn.Module):
    """`(x - mean) / std` per column, and back; `adapt` sets these buffers from training data."""

    def __init__(self, columns: int) -> None:
        super().__init__()
        self.mean = nn.Buffer(torch.zeros(columns))
        self.std = nn.Buffer(torch.ones(columns))

    def adapt(self, values: Tensor) -> None:
        """Take mean and standard deviation from rows (B, columns); a constant is not scaled."""
        std = values.std(dim=0, correction=0)
        self.mean.copy_(values.mean(dim=0))
        # not 0: a constant would be divided by its rounding error
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
        spread: of the stated deviations: of N magnitudes, or of magnitude, N, and angle, degrees.
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
        """The answers for tension differences (B, M) and, if pose-aware, commands (B, 2N)."""


class SingleContactTarget(NamedTuple):
    """True contacts of B samples: segment (B,), 0 for none; angle (B,), deg; magnitude (B,), N."""

    segment: Tensor
    angle_deg: Tensor
    magnitude_n: Tensor


class MultiContactTarget(NamedTuple):
    """True contacts of B samples: touched (B, N), 0 or 1; magnitudes (B, N), N, 0 elsewhere."""

    touched: Tensor
    magnitude_n: Tensor


class LossTerms(NamedTuple):
    """The parts of a loss; `total` is equation (8); `spread` is trained separately."""

    total: Tensor
    contact: Tensor
    direction: Tensor
    magnitude: Tensor
    spread: Tensor


def direction_of(angle_deg: Tensor) -> Tensor:
    """(B, 2) (sin θ, cos θ) of angles (B,), equation (5)."""
    angle = torch.deg2rad(angle_deg)
    return torch.stack([torch.sin(angle), torch.cos(angle)], dim=-1)


def angle_error_deg(direction: Tensor, angle_deg: Tensor) -> Tensor:
    """Signed difference (B,), ±180 at most, of directions (B, 2), any length, from angles (B,)."""
    true = direction_of(angle_deg)
    sine = direction[:, 0] * true[:, 1] - direction[:, 1] * true[:, 0]
    cosine = direction[:, 0] * true[:, 0] + direction[:, 1] * true[:, 1]
    return torch.rad2deg(torch.atan2(sine, cosine))


def gaussian_nll(error: Tensor, std: Tensor) -> Tensor:
    """Negative log-likelihood, without its constant, of errors under a stated deviation."""
    return 0.5 * (error / std) ** 2 + torch.log(std)


def single_contact_loss(
    output: SingleContactOutput, target: SingleContactTarget, magnitude_scale_n: Tensor
) -> LossTerms:
    """Equation (8) with α = β = γ = 1.

    Cross-entropy (4), the squared error (6) of (sin θ, cos θ) and L1 on standardised magnitudes
    (7), the last two over contacts.
    """
    touched = target.segment > 0
    contact = functional.cross_entropy(output.contact_logits, target.segment)
    off = output.direction - direction_of(target.angle_deg)
    direction = _mean_where((off**2).sum(dim=-1), touched)
    error_n = output.magnitude_n - target.magnitude_n
    magnitude = _mean_where(error_n.abs() / magnitude_scale_n, touched)
    angle_error = angle_error_deg(output.direction, target.angle_deg).detach()
    spread = gaussian_nll(error_n.detach(), output.magnitude_std_n)
    spread = spread + gaussian_nll(angle_error, output.angle_std_deg)
    total = contact + direction + magnitude
    return LossTerms(total, contact, direction, magnitude, _mean_where(spread, touched))


def multi_contact_loss(
    output: MultiContactOutput, target: MultiContactTarget, magnitude_scale_n: Tensor
) -> LossTerms:
    """Cross-entropy of each segment's contact and L1 on standardised magnitudes; no directions."""
    contact = functional.binary_cross_entropy_with_logits(output.contact_logits, target.touched)
    error_n = output.magnitude_n - target.magnitude_n
    magnitude = (error_n.abs() / magnitude_scale_n).mean()
    spread = gaussian_nll(error_n.detach(), output.magnitude_std_n)
    spread = _mean_where(spread, target.touched > 0)
    total = contact + magnitude
    return LossTerms(total, contact, torch.zeros_like(total), magnitude, spread)


def single_contact_ratios(output: SingleContactOutput, target: SingleContactTarget) -> Tensor:
    """|error| / stated deviation (B, 2) of magnitude and angle; NaN where no contact was found."""
    force = (output.magnitude_n - target.magnitude_n).abs() / output.magnitude_std_n
    angle = angle_error_deg(output.direction, target.angle_deg).abs() / output.angle_std_deg
    hits = (target.segment > 0) & (output.contact_logits.argmax(-1) > 0)
    return torch.stack([force, angle], dim=-1).where(hits[:, None], math.nan)


def multi_contact_ratios(output: MultiContactOutput, target: MultiContactTarget) -> Tensor:
    """|error| / stated deviation (B, N) of magnitudes; NaN where no contact was found."""
    ratio = (output.magnitude_n - target.magnitude_n).abs() / output.magnitude_std_n
    return ratio.where((target.touched > 0) & (output.contact_logits > 0), math.nan)


def _mean_where(values: Tensor, chosen: Tensor) -> Tensor:
    """Mean over the chosen entries, 0 where there are none."""
    return values.where(chosen, 0.0).sum() / chosen.sum().clamp(min=1)
