"""The losses (4) to (8) of the paper, for one contact or several, and of the stated spread."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from cablesense_training.networks.layers import MultiContactOutput, SingleContactOutput


@dataclass(frozen=True)
class LossWeights:
    """α, β and γ of equation (8): weights of contact, direction and magnitude."""

    alpha: float = 1.0
    beta: float = 1.0
    gamma: float = 1.0


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
    """The parts of a loss; `total` is equation (8), and `spread` is trained beside it, apart."""

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


def direction_loss(direction: Tensor, angle_deg: Tensor, touched: Tensor) -> Tensor:
    """Squared error of (sin θ, cos θ), equation (6), over the touched samples."""
    squared = ((direction - direction_of(angle_deg)) ** 2).sum(dim=-1)
    return _mean_where(squared, touched)


def gaussian_nll(error: Tensor, std: Tensor) -> Tensor:
    """Negative log-likelihood, without its constant, of errors under a stated deviation."""
    return 0.5 * (error / std) ** 2 + torch.log(std)


def single_contact_loss(
    output: SingleContactOutput,
    target: SingleContactTarget,
    magnitude_scale_n: Tensor,
    weights: LossWeights,
) -> LossTerms:
    """Equation (8) with cross-entropy (4), direction (6) and L1 on standardised magnitudes (7).

    `magnitude_scale_n` is the standard deviation that standardises the labels; their mean cancels
    in the difference.
    """
    touched = target.segment > 0
    contact = functional.cross_entropy(output.contact_logits, target.segment)
    direction = direction_loss(output.direction, target.angle_deg, touched)
    error_n = output.magnitude_n - target.magnitude_n
    magnitude = _mean_where(error_n.abs() / magnitude_scale_n, touched)
    total = weights.alpha * contact + weights.beta * direction + weights.gamma * magnitude
    angle_error = angle_error_deg(output.direction, target.angle_deg).detach()
    spread = gaussian_nll(error_n.detach(), output.magnitude_std_n)
    spread = spread + gaussian_nll(angle_error, output.angle_std_deg)
    return LossTerms(total, contact, direction, magnitude, _mean_where(spread, touched))


def multi_contact_loss(
    output: MultiContactOutput,
    target: MultiContactTarget,
    magnitude_scale_n: Tensor,
    weights: LossWeights,
) -> LossTerms:
    """Cross-entropy of each segment's contact and L1 on standardised magnitudes; no directions."""
    contact = functional.binary_cross_entropy_with_logits(output.contact_logits, target.touched)
    error_n = output.magnitude_n - target.magnitude_n
    magnitude = (error_n.abs() / magnitude_scale_n).mean()
    total = weights.alpha * contact + weights.gamma * magnitude
    spread = gaussian_nll(error_n.detach(), output.magnitude_std_n)
    return LossTerms(
        total, contact, torch.zeros_like(total), magnitude, _mean_where(spread, target.touched > 0)
    )


def _mean_where(values: Tensor, chosen: Tensor) -> Tensor:
    """Mean over the chosen entries, 0 where there are none."""
    kept = torch.where(chosen, values, torch.zeros_like(values))
    return kept.sum() / chosen.sum().clamp(min=1)
