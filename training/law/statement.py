"""What evidence says of one contact and of its rivals: the second half of the estimator.

It knows nothing of arms: links with levers, channels with information, and where links are touched
are all that it needs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from cablesense_sim.touch import TouchedPlaces
from cablesense_training.law.evidence import Evidence
from cablesense_training.law.geometry import Matrix, constant
from cablesense_training.law.hypotheses import RivalHypotheses
from cablesense_training.law.posterior import (
    GRID_POINTS,
    LARGEST_N,
    ContactPosterior,
    PosteriorOfContact,
)
from cablesense_training.law.wrench import WrenchFit

_POINTS = 49
"""Points at which a distribution is taken for the ends of its interval."""
_QUANTILES_HALF_WIDTH_STD = 4.0
"""Standard deviations that they cover to each side."""
_LOW = 0.025
"""Lower end of the 95 % intervals, as a probability."""
_HIGH = 0.975
"""Upper end of the 95 % intervals, as a probability."""
_Y = 1
_Z = 2
"""Rows of the lateral components in a covariance (3, 3) of the force."""
_AROUND_Z = 4
_AROUND_Y = 5
"""Rows in the covariance (6, 6) of place, force (x, y, z), and lever times the force's y and z.

The lever times a force along y is the moment around z, times one along z it is that around -y.
"""
_ZERO_VARIANCE_N2_M2 = 1e-18
"""Variance, (N·m)², that counts as zero: its root has no derivative there."""


class Statement(NamedTuple):
    """What evidence says, as tensors: each is described at `cablesense_contact.law.LawOutput`."""

    contact_evidence: Tensor
    segment_evidence: Tensor
    several_evidence: Tensor
    faulty_evidence: Tensor
    faulty_segment_evidence: Tensor
    exchanged_evidence: Tensor
    free_chi2: Tensor
    contact_chi2: Tensor
    several_chi2: Tensor
    place_m: Tensor
    place_ci95_m: Tensor
    region_m: Tensor
    force_n: Tensor
    contact_covariance: Tensor
    magnitude_ci95_n: Tensor
    moment_n_m: Tensor
    moment_std_n_m: Tensor
    fault_n: Tensor


class ContactStatement(nn.Module):
    """`Statement` of `Evidence`, for N links.

    Args:
        touched: where the links can be touched.
        length_m: (N,) of the links.
        joint_m: (N,) where their frames are along all links.
        torque_scale: (T,) prior deviation of contact torques at the joints, each by itself.
        felt_across: (N, 2, 2) projections of forces across the links, along y and z, to what
            makes a torque in some pose, in which they are stated; all of them by default.
        partly_felt: whether there may be poses in which forces in some direction across a link
            make no torque. A magnitude is then known no better than as that direction allows, and
            as the link is: a moment is told, and on each link another force makes it.
    """

    def __init__(
        self,
        touched: TouchedPlaces,
        length_m: Matrix,
        joint_m: Matrix,
        torque_scale: Matrix,
        *,
        felt_across: Matrix | None = None,
        partly_felt: bool = False,
    ) -> None:
        super().__init__()
        self.partly_felt = partly_felt
        projections = np.eye(2) if felt_across is None else felt_across
        self.wrench = WrenchFit(length_m, projections)
        self.contact = PosteriorOfContact(touched, projections)
        self.rivals = RivalHypotheses(torque_scale)
        self.points = constant(np.linspace(0.0, 1.0, _POINTS))
        self.ends = constant(np.array([[_LOW], [_HIGH]]))
        self.low_m = constant(touched.touched_m[:, :1, None])
        self.high_m = constant(touched.touched_m[:, 1:, None])
        self.joint_m = constant(joint_m[:, None, None])
        self.numbers = constant(np.arange(len(length_m)))
        self.earlier = constant(np.tril(np.ones((len(length_m), len(length_m))), -1).T)
        self.to_covariance = constant(_to_covariance())
        self.around_axes = constant(np.array([[0.0, 1.0], [-1.0, 0.0]]))
        # where variances stand in covariances that are laid flat, (6, 6) and (3, 3)
        lateral = np.array([_flat(_Y, 3), _flat(_Z, 3)])
        self.moment_variances = constant(np.array([_flat(_AROUND_Y, 6), _flat(_AROUND_Z, 6)]))
        self.lateral_entries = constant(lateral)
        self.lateral_variances = constant(1 + lateral)  # behind the variance of the place
        self.grid_shape = (-1, 20, GRID_POINTS)
        self.unfelt = None if felt_across is None else constant(_unfelt_covariance(felt_across))

    def forward(self, seen: Evidence) -> Statement:
        """The statement."""
        wrench = self.wrench(seen)
        contact = self.contact(wrench, self.wrench)
        if seen.log_share is not None:
            contact = contact._replace(log_evidence=contact.log_evidence + seen.log_share)
        rival = self.rivals(seen, wrench)
        best = contact.log_evidence.argmax(1, keepdim=True)
        chosen = (best == self.numbers).to(seen.reading_n.dtype)[:, None]
        gain = (chosen @ contact.chi2_gain[..., None])[:, 0, 0]
        place_ci, region = self._places(contact, chosen)

        # the grid of the likeliest segment
        place_m = torch.minimum(torch.maximum(contact.place_m, self.low_m), self.high_m)
        rows = (
            # values, 6 rows: place, force (x, y, z), and moments around z and around -y
            place_m,
            contact.force_n,
            contact.line_m * contact.force_n[:, :, 1:],
            # weight, 1 row
            contact.weight,
            # within a point of the grid, 10 rows: variance of place, covariance (3, 3) of force
            contact.place_variance_m2,
            contact.covariance_n2,
            # square of the lever, 1 row
            contact.line_m**2,
            # square and variance of the lateral force, 1 row each
            contact.lateral_squared_n2,
            contact.lateral_variance_n2,
        )
        grid = (chosen @ torch.cat(rows, dim=2).flatten(2)).reshape(self.grid_shape)
        values, weight, within, square_m2, squared, variance = grid.split((6, 1, 10, 1, 1, 1), 1)
        means = values @ weight.transpose(1, 2)
        offsets = values - means
        moment_variance = within.index_select(1, self.lateral_variances) * square_m2
        mean_within = torch.cat([within, moment_variance], dim=1) @ weight.transpose(1, 2)
        mean_within = (mean_within.transpose(1, 2) @ self.to_covariance).reshape(-1, 6, 6)
        spread = (offsets * weight) @ offsets.transpose(1, 2) + mean_within
        magnitudes = weight, squared, variance
        if self.partly_felt:
            magnitudes = self._of_any_link(contact)
        covariance = spread[:, :4, :4]
        if self.unfelt is not None:
            covariance = covariance + (chosen @ self.unfelt).reshape(-1, 4, 4)
        place, force, around = means[:, :, 0].split((1, 3, 2), dim=1)
        moment_variance = spread.flatten(1).index_select(1, self.moment_variances)
        return Statement(
            contact_evidence=contact.log_evidence,
            segment_evidence=rival.segment,
            several_evidence=rival.several,
            faulty_evidence=rival.faulty_free,
            faulty_segment_evidence=rival.faulty_segment,
            exchanged_evidence=rival.exchanged_free,
            free_chi2=rival.free_chi2,
            contact_chi2=rival.free_chi2 - gain,
            several_chi2=rival.free_chi2 - rival.several_gain,
            place_m=place[:, 0],
            place_ci95_m=place_ci,
            region_m=region,
            force_n=force,
            contact_covariance=covariance,
            magnitude_ci95_n=self._magnitudes(*magnitudes),
            moment_n_m=around @ self.around_axes,
            moment_std_n_m=torch.sqrt(moment_variance.clamp(min=_ZERO_VARIANCE_N2_M2)),
            fault_n=rival.faulty_free_n,
        )

    def _of_any_link(self, one: ContactPosterior) -> tuple[Tensor, Tensor, Tensor]:
        """Weights, squares and variances (B, 1, N K) of magnitudes, whichever link is touched."""
        within = one.covariance_n2.index_select(2, self.lateral_entries)
        aside = within.sum(2, keepdim=True) - one.lateral_variance_n2
        squared, variance = _with_aside(
            one.lateral_squared_n2, one.lateral_variance_n2, aside.clamp(min=0.0)
        )
        probability = torch.softmax(one.log_evidence, dim=1)
        weight = probability[:, :, None, None] * one.weight
        count = weight.shape[1] * weight.shape[3]
        shape = (-1, 1, count)
        return weight.reshape(shape), squared.reshape(shape), variance.reshape(shape)

    def _magnitudes(self, weight: Tensor, squared_n2: Tensor, variance_n2: Tensor) -> Tensor:
        """The interval (B, 2) of a mixture (B, 1, K) of normal magnitudes, up to the largest."""
        lateral = torch.sqrt(squared_n2)
        mean, std = _moments(weight, lateral, variance_n2)
        low = (mean - _QUANTILES_HALF_WIDTH_STD * std).clamp(min=0.0)
        points = low + (mean + _QUANTILES_HALF_WIDTH_STD * std - low) * self.points
        cdf = _mixture_cdf(points, mean, std, weight, lateral, variance_n2)
        # forces beyond the largest that is expected count only where all are
        inside = (cdf * (points <= LARGEST_N)).amax(2, keepdim=True)
        most = torch.where(inside > _LOW, inside, cdf[:, :, -1:])
        return _quantiles(points, cdf / most, self.ends)

    def _places(self, one: ContactPosterior, chosen: Tensor) -> tuple[Tensor, Tensor]:
        """The intervals (B, 2) of the place on the chosen segment, and along the arm."""
        mean, std = _moments(one.weight, one.place_m, one.place_variance_m2)
        width = _QUANTILES_HALF_WIDTH_STD * std
        low = torch.minimum(torch.maximum(mean - width, self.low_m), self.high_m - std)
        high = torch.maximum(torch.minimum(mean + width, self.high_m), self.low_m + std)
        points = low + (high - low) * self.points
        cdf = _mixture_cdf(points, mean, std, one.weight, one.place_m, one.place_variance_m2)
        # what lies beyond the ends of the segment is taken to be on it
        first = cdf[..., :1]
        cdf = (cdf - first) / (cdf[..., -1:] - first).clamp(min=1e-12)
        chosen_cdf = chosen @ torch.cat([points, cdf], dim=3).flatten(2)
        own_points, own_cdf = chosen_cdf.split(_POINTS, dim=2)
        interval = _quantiles(own_points, own_cdf, self.ends)
        probability = torch.softmax(one.log_evidence, dim=1)
        before = probability @ self.earlier
        along = points + self.joint_m
        along_cdf = before[:, :, None, None] + probability[:, :, None, None] * cdf
        return interval, _quantiles(
            along.flatten(1)[:, None], along_cdf.flatten(1)[:, None], self.ends
        )


def _with_aside(
    squared_n2: Tensor, variance_n2: Tensor, aside_n2: Tensor
) -> tuple[Tensor, Tensor]:
    """Square and variance of magnitudes, with what is unknown beside the mean force.

    A force of mean m along itself, with variances v along and p beside m, has E f² = m² + v + p
    and var f² = 4 m² v + 2 v² + 2 p². A normal magnitude with these two has

        μ⁴ = (E f²)² - var f² / 2 = m⁴ + 2 p (m² + v),   σ² = E f² - μ².
    """
    square = torch.sqrt(squared_n2**2 + 2.0 * aside_n2 * (squared_n2 + variance_n2))
    return square, squared_n2 + variance_n2 + aside_n2 - square


def _moments(weight: Tensor, value: Tensor, variance: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and deviation (..., 1, 1) of a mixture (..., 1, K) of normal distributions."""
    mean = (weight * value).sum(-1, keepdim=True)
    square = weight * (variance + (value - mean) ** 2)
    return mean, torch.sqrt(square.sum(-1, keepdim=True))


def _mixture_cdf(
    points: Tensor, mean: Tensor, std: Tensor, weight: Tensor, value: Tensor, variance: Tensor
) -> Tensor:
    """(..., 1, Q) distribution function of a mixture (..., 1, K) at points (..., 1, Q).

    In single precision, relative to the mean and the deviation of the mixture, as ONNX Runtime
    has the error function in that alone.
    """
    place = ((points - mean) / std).float()
    offset = ((value - mean) / std).float().transpose(-1, -2)
    scale = (std * torch.rsqrt(2.0 * variance)).float().transpose(-1, -2)
    shares = torch.erf((place - offset) * scale)
    return 0.5 + 0.5 * (weight.float() @ shares).double()


def _quantiles(points: Tensor, cdf: Tensor, shares: Tensor) -> Tensor:
    """(B, S) where a distribution function (B, 1, Q) at ascending points reaches shares (S, 1).

    Between two points it is linear: of each step there is what the share exceeds the lower end by.
    """
    lower = cdf[:, :, :-1]
    rise = (cdf[:, :, 1:] - lower).clamp(min=1e-12)
    part = ((shares - lower) / rise).clamp(0.0, 1.0)
    step = points[:, :, 1:] - points[:, :, :-1]
    return (points[:, :, :1] + part @ step.transpose(1, 2))[:, :, 0]


def _unfelt_covariance(felt_across: Matrix) -> Matrix:
    """(N, 16): the covariance (4, 4) of place and force by what is not felt of a force."""
    covariance = np.zeros((len(felt_across), 4, 4))
    covariance[:, 2:, 2:] = LARGEST_N**2 * (np.eye(2) - felt_across)
    return covariance.reshape(-1, 16)


def _flat(row: int, size: int) -> int:
    """Where the variance of a row stands in a covariance (size, size) that is laid flat."""
    return row * size + row


def _to_covariance() -> Matrix:
    """(12, 36): variances of the place, of the force (3, 3) and of two moments, to one matrix."""
    placed = np.zeros((12, 6, 6))
    placed[0, 0, 0] = 1.0
    placed[1:10, 1:4, 1:4] = np.eye(9).reshape(9, 3, 3)
    placed[10, 4, 4] = 1.0
    placed[11, 5, 5] = 1.0
    return placed.reshape(12, 36)
