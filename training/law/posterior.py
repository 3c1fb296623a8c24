"""The posterior of one contact: place, force and moment, on every segment, as array code.

A force f on segment n makes the joint torques (A_n + s B_n)' f, where s is the distance of its line
of action from the joint centre, taken along the axis. For each s on a grid the force is a linear
fit to what readings say of the torques, and the evidence of that fit is the density over s; the
grid is narrowed twice to where the density is. Forces are uniform in direction and magnitude
across the segment.

Contacts are on a surface, at a radius r from the axis. There an axial force f_x, which friction
bounds to about μ f, adds the moment r f_x: the place is not s but s - r f_x / f. So s is fitted
beyond both ends of a segment too, and the place follows from it with the width that r and f_x
leave. The torsion of a force that does not point at the axis is one more unknown.

Manuelli and Tedrake, Localizing External Contact Using Proprioceptive Sensors, IROS 2016, draw
particles of the same posterior.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from cablesense_training.law.geometry import constant, error_function

LARGEST_N = 200.0
"""Lateral force up to which contacts are expected: a person's firm push."""

AXIAL_STD_N = 100.0
"""Prior deviation of the axial force of contacts on the axis: half the largest lateral force."""

RADIUS_MEAN = 0.5
RADIUS_STD = 12.0**-0.5
"""Where a surface is touched, from the axis, as shares of its radius: anywhere, uniformly. Plates
and cables stand out by different amounts, and a tool may reach between them."""

_LEAST_N = 0.05
"""Added to lateral forces where something is divided by them or scales with them."""
_PLACES = 25
"""Places of a segment's grid."""
_REFINED = 2
"""Times that the grid is narrowed."""
_WIDTH = 5.0
"""Standard deviations of the place that a narrowed grid covers to each side."""
_BEYOND = 3.0
"""Deviations of r f_x / f by which s is looked for beyond the ends of a segment."""
_TINY = 1e-18


class ContactPosterior(NamedTuple):
    """One contact on each of N segments, for B samples, on grids of K places.

    Forces are along the axes that a segment has at the command.

    Attributes:
        log_evidence: (B, N) of a contact on this segment, with the prior density of its place.
        chi2_gain: (B, N) by how much the best place lowers χ².
        weight: (B, N, K) probabilities of the grid's places.
        place_m, place_std_m: (B, N, K) places on the segment and what is unknown beside the grid.
        means: (B, N, 4) of place, m, and force, N.
        covariance: (B, N, 4, 4) of place, m, and force, N.
        moment_n_m: (B, N, 2) mean moment about the joint centre, around y and z.
        moment_std_n_m: (B, N, 2).
        lateral_n, lateral_std_n: (B, N, K) magnitude across the segment at each place.
    """

    log_evidence: Tensor
    chi2_gain: Tensor
    weight: Tensor
    place_m: Tensor
    place_std_m: Tensor
    means: Tensor
    covariance: Tensor
    moment_n_m: Tensor
    moment_std_n_m: Tensor
    lateral_n: Tensor
    lateral_std_n: Tensor


class _Products(NamedTuple):
    """The nine elements of (A + s B) P (A + s B)' and the three of (A + s B) P τ, by powers of s.

    Attributes:
        constant: (B, N, 12, 1).
        by_powers: (B, N, 12, 2) factors of s and s².
    """

    constant: Tensor
    by_powers: Tensor


class _Fits(NamedTuple):
    """The forces at all K places of the grids.

    Attributes:
        log_density, chi2_gain, lateral_squared, lateral_variance: (B, N, 1, K).
        force: (B, N, 3, K).
        covariance: (B, N, 6, K): xx, xy, xz, yy, yz, zz.
    """

    log_density: Tensor
    chi2_gain: Tensor
    force: Tensor
    covariance: Tensor
    lateral_squared: Tensor
    lateral_variance: Tensor


class PosteriorOfContact(nn.Module):
    """`ContactPosterior` from torques.

    Args:
        reach_m: (N, 2) places on each segment where it can be touched.
        radius_m: (N,) of the touched surface; zero where contacts act on the axis.
        friction: coefficient of that surface, the deviation of axial over lateral force; zero
            where contacts act on the axis, with any axial force.
    """

    def __init__(self, reach_m: np.ndarray, radius_m: np.ndarray, friction: float) -> None:
        super().__init__()
        self.on_surface = friction > 0.0
        self.friction = friction
        radius = radius_m[None, :, None, None]
        low = reach_m[None, :, :1, None]
        high = reach_m[None, :, 1:, None]
        offset = _BEYOND * friction * radius * np.hypot(RADIUS_MEAN, RADIUS_STD)
        self.radius_m = constant(radius)
        self.low_m = constant(low)
        self.high_m = constant(high)
        self.first_m = constant(low - offset)
        self.last_m = constant(high + offset)
        self.axial_std = constant(np.full_like(low, AXIAL_STD_N))
        self.shares = constant(np.linspace(0.0, 1.0, _PLACES))
        self.lateral_variances = constant(np.array([3, 5]))
        self.around_axes = constant(np.array([[0.0, 1.0], [-1.0, 0.0]]))
        self.other_axis = constant(np.array([[0.0, 1.0], [1.0, 0.0]]))
        self.symmetric = constant(_symmetric())
        total_m = float((reach_m[:, 1] - reach_m[:, 0]).sum())
        # of the place, of the direction, and of the magnitude: 1 / (2π f F L), the force in its
        # plane; with 2π of the Gaussian integral over the lateral force
        self.log_prior = -float(np.log(LARGEST_N * total_m))

    def forward(
        self,
        precision: Tensor,
        pull: Tensor,
        at_joint_m: Tensor,
        by_place: Tensor,
        by_torsion: Tensor,
    ) -> ContactPosterior:
        """The posterior.

        Args:
            precision: (B, 2N, 2N) of the torques.
            pull: (B, 2N) precision times torque.
            at_joint_m, by_place: (B, N, 3, 2N) levers A and B.
            by_torsion: (B, N, 2N).
        """
        precision = precision[:, None]
        pull = pull[:, None, None]
        step = (self.last_m - self.first_m) / (_PLACES - 1)
        place = self.first_m + (self.last_m - self.first_m) * self.shares
        axial_std = self.axial_std
        torsion = None
        products = _products(precision, pull, at_joint_m, by_place)
        for _ in range(_REFINED):
            fits = self._fits(products, place, axial_std)
            weight = torch.softmax(fits.log_density, dim=3)
            mean = (weight * place).sum(3, keepdim=True)
            variance = (weight * (place - mean) ** 2).sum(3, keepdim=True)
            width = _WIDTH * (torch.sqrt(variance) + 0.5 * step)
            if self.on_surface:
                nearness = weight * torch.rsqrt(fits.lateral_squared + _LEAST_N**2)
                axial_std = self.friction / nearness.sum(3, keepdim=True)
                if torsion is None:
                    std_n_m = (self.radius_m * axial_std)[..., 0]
                    torsion = _beside(precision, pull, by_torsion, std_n_m)
                    products = _products(torsion.precision, torsion.pull, at_joint_m, by_place)
            low = torch.maximum(self.first_m, mean - width)
            high = torch.minimum(self.last_m, mean + width)
            step = (high - low) / (_PLACES - 1)
            place = low + (high - low) * self.shares
        fits = self._fits(products, place, axial_std)
        posterior = self._summary(fits, place, step)
        if torsion is None:
            return posterior
        return posterior._replace(
            log_evidence=posterior.log_evidence + torsion.log_evidence,
            chi2_gain=posterior.chi2_gain + torsion.gain,
        )

    def _fits(self, products: _Products, s: Tensor, axial_std: Tensor) -> _Fits:
        """The force at each place: f = V (A + s B) P τ with V⁻¹ = (A + s B) P (A + s B)' + prior."""
        powers = torch.cat([s, s * s], dim=2)
        products = products.constant + products.by_powers @ powers
        xx, xy, xz, _, yy, yz, _, _, zz, x, y, z = products.split(1, dim=2)
        xx = xx + axial_std**-2
        yy = yy + LARGEST_N**-2
        zz = zz + LARGEST_N**-2
        # the inverse of a symmetric matrix by its cofactors
        c_xx = yy * zz - yz * yz
        c_xy = xz * yz - xy * zz
        c_xz = xy * yz - xz * yy
        c_yy = xx * zz - xz * xz
        c_yz = xy * xz - xx * yz
        c_zz = xx * yy - xy * xy
        determinant = xx * c_xx + xy * c_xy + xz * c_xz
        f_x = (c_xx * x + c_xy * y + c_xz * z) / determinant
        f_y = (c_xy * x + c_yy * y + c_yz * z) / determinant
        f_z = (c_xz * x + c_yz * y + c_zz * z) / determinant
        gain = f_x * x + f_y * y + f_z * z
        squared = f_y * f_y + f_z * f_z + _TINY
        variance = f_y * f_y * c_yy + 2.0 * f_y * f_z * c_yz + f_z * f_z * c_zz
        variance = variance / (squared * determinant)
        # the density 1 / (2π f F) of a force has no pole where f is known to its deviation only
        scale = determinant * torch.maximum(squared, variance) * axial_std**2
        log_density = 0.5 * (gain - torch.log(scale))
        cofactors = torch.cat([c_xx, c_xy, c_xz, c_yy, c_yz, c_zz], dim=2)
        return _Fits(
            log_density=log_density,
            chi2_gain=gain,
            force=torch.cat([f_x, f_y, f_z], dim=2),
            covariance=cofactors / determinant,
            lateral_squared=squared,
            lateral_variance=variance,
        )

    def _summary(self, fits: _Fits, s: Tensor, step: Tensor) -> ContactPosterior:
        """Places, means, covariances and evidence over the grids of s (B, N, 1, K)."""
        place = s
        variance = step**2 / 12.0 + 0.0 * s
        log_density = fits.log_density
        force_x = fits.force[:, :, :1]
        if self.on_surface:
            per_squared = 1.0 / (fits.lateral_squared + _LEAST_N**2)
            shift = force_x * torch.sqrt(per_squared)
            spread = fits.covariance[:, :, :1] * per_squared
            place = s - RADIUS_MEAN * self.radius_m * shift
            variance = variance + self.radius_m**2 * (
                RADIUS_STD**2 * shift**2 + (RADIUS_STD**2 + RADIUS_MEAN**2) * spread
            )
            # the place is on the segment: the share of its distribution that is there
            scale = torch.rsqrt(2.0 * variance)
            ends = torch.cat([self.low_m, self.high_m], dim=2)
            below, above = error_function((ends - place) * scale).split(1, dim=2)
            log_density = log_density + torch.log(0.5 * (above - below) + 1e-12)
        weight = torch.softmax(log_density, dim=3)
        log_evidence = torch.logsumexp(log_density, dim=3) + torch.log(step[..., 0])
        place_in = torch.minimum(torch.maximum(place, self.low_m), self.high_m)

        values = torch.cat([place_in, fits.force], dim=2)
        means = (weight * values).sum(3, keepdim=True)
        offsets = values - means
        between = (offsets * weight) @ offsets.transpose(2, 3)
        within = (weight * torch.cat([variance, fits.covariance], dim=2)).sum(3)
        within = (within @ self.symmetric).reshape(between.shape)

        around = s * fits.force[:, :, 1:]
        moment = (weight * around).sum(3)
        own = s**2 * fits.covariance.index_select(2, self.lateral_variances)
        moment_variance = (weight * (own + around**2)).sum(3) - moment**2
        return ContactPosterior(
            log_evidence=log_evidence[:, :, 0] + self.log_prior,
            chi2_gain=fits.chi2_gain.amax((2, 3)),
            weight=weight[:, :, 0],
            place_m=place[:, :, 0],
            place_std_m=torch.sqrt(variance)[:, :, 0],
            means=means[..., 0],
            covariance=between + within,
            moment_n_m=moment @ self.around_axes,
            moment_std_n_m=torch.sqrt(moment_variance.clamp(min=_TINY)) @ self.other_axis,
            lateral_n=torch.sqrt(fits.lateral_squared)[:, :, 0],
            lateral_std_n=torch.sqrt(fits.lateral_variance)[:, :, 0],
        )


def _symmetric() -> np.ndarray:
    """(7, 16): the variance of the place and xx, xy, xz, yy, yz, zz of the force to a matrix."""
    placed = np.zeros((7, 4, 4))
    pairs = ((0, 0), (1, 1), (1, 2), (1, 3), (2, 2), (2, 3), (3, 3))
    for k, (i, j) in enumerate(pairs):
        placed[k, i, j] = 1.0
        placed[k, j, i] = 1.0
    return placed.reshape(7, 16)


class _Beside(NamedTuple):
    """Torques beside an unknown moment, and what that explains by itself.

    Attributes:
        precision: (B, N, 2N, 2N), and
        pull: (B, N, 1, 2N) of the torques that are left.
        gain, log_evidence: (B, N) of the moment, against none.
    """

    precision: Tensor
    pull: Tensor
    gain: Tensor
    log_evidence: Tensor


def _beside(precision: Tensor, pull: Tensor, lever: Tensor, std: Tensor) -> _Beside:
    """Take an unknown moment with the torques `lever` (B, N, 2N) out of torques (Woodbury).

    `std` (B, N, 1) is its prior deviation.
    """
    weighted = (precision @ lever[..., None])[..., 0]
    own = (weighted * lever).sum(2, keepdim=True)
    along = (lever * pull[:, :, 0]).sum(2, keepdim=True)
    variance = std**2
    share = variance / (1.0 + variance * own)
    gain = (share * along**2)[..., 0]
    return _Beside(
        precision - (share * weighted)[..., None] * weighted[:, :, None],
        pull - (share * along * weighted)[:, :, None],
        gain,
        0.5 * (gain - torch.log(1.0 + variance * own)[..., 0]),
    )


def _products(precision: Tensor, pull: Tensor, levers: Tensor, by_place: Tensor) -> _Products:
    """Products of the levers (B, N, 3, 2N) with precision (B, N, 2N, 2N) and pull (B, N, 1, 2N)."""
    both = torch.cat([levers, by_place], dim=2)
    weighted = both @ precision
    pulls = (both * pull).sum(3, keepdim=True)
    whole = torch.cat([weighted @ both.transpose(2, 3), pulls], dim=3)
    at_joint, sloped = whole.split(3, dim=2)
    first = at_joint[..., :3].flatten(2)
    mixed = (at_joint[..., 3:6] + sloped[..., :3]).flatten(2)
    squared = sloped[..., 3:6].flatten(2)
    by_place_pull = sloped[..., 6]
    constant_part = torch.cat([first, at_joint[..., 6]], dim=2)
    linear_part = torch.cat([mixed, by_place_pull], dim=2)
    quadratic_part = torch.cat([squared, 0.0 * by_place_pull], dim=2)
    return _Products(constant_part[..., None], torch.stack([linear_part, quadratic_part], dim=-1))
