"""The losses (4) to (8) of the paper, for one contact or several, and of the stated spread."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from cablesense_training.networks.layers import MultiContactOutput, SingleContactOutput


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


def pinball(error: Tensor, quantile: float) -> Tensor:
    """Loss of true less stated values that is least where the stated is that quantile.

    Koenker and Bassett, Regression Quantiles, 1978.
    """
    return torch.maximum(quantile * error, (quantile - 1.0) * error)


def single_contact_loss(
    output: SingleContactOutput, target: SingleContactTarget, magnitude_scale_n: Tensor
) -> LossTerms:
    """Equation (8) with α = β = γ = 1.

    Cross-entropy (4), the squared error (6) of (sin θ, cos θ) and L1 on standardised magnitudes
    (7), the last two over contacts. `magnitude_scale_n` is the standard deviation that
    standardises the labels; their mean cancels in the difference.
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
    found = (target.segment > 0) & (output.contact_logits.argmax(-1) > 0)
    return torch.stack([force, angle], dim=-1).where(found[:, None], math.nan)


def multi_contact_ratios(output: MultiContactOutput, target: MultiContactTarget) -> Tensor:
    """|error| / stated deviation (B, N) of magnitudes; NaN where no contact was found."""
    ratio = (output.magnitude_n - target.magnitude_n).abs() / output.magnitude_std_n
    return ratio.where((target.touched > 0) & (output.contact_logits > 0), math.nan)


def _mean_where(values: Tensor, chosen: Tensor) -> Tensor:
    """Mean over the chosen entries, 0 where there are none."""
    return values.where(chosen, 0.0).sum() / chosen.sum().clamp(min=1)
