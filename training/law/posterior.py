"""The posterior of one contact: place, force and moment, on every segment, as array code.

A force f on segment n makes the joint torques (A_n + s B_n)' f, where s is the distance of its
line of action from the joint centre, taken along the axis. For each s on a grid the force is a
linear fit to what readings say of the torques, and the evidence of that fit is the density over s.
The grid is where the fit of a wrench (`wrench`) sees the contact, or the whole segment. Forces are
uniform in direction and magnitude across the segment.

Contacts are on a surface, at a radius r from the axis. There an axial force f_x, which friction
bounds to about μ f, adds the moment r f_x: the place is not s but s - r f_x / f. So s is fitted
beyond both ends of a segment too, and the place follows from it with the width that r and f_x
leave. Friction around the segment lets the force point beside the axis, by an angle φ of about μ.
Then two more moments are unknown: the torsion r f sin φ, and the part r f_x sin φ of the axial
force's moment that is not along the place.

Manuelli and Tedrake, Localizing External Contact Using Proprioceptive Sensors, IROS 2016, draw
particles of the same posterior.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from cablesense_sim.touch import TouchedPlaces
from cablesense_training.law.geometry import Matrix, constant, error_function
from cablesense_training.law.wrench import ContactLine, SegmentWrench, Strength, WrenchFit

LARGEST_N = 200.0
"""Lateral force up to which contacts are expected: a person's firm push."""

AXIAL_STD_N = 100.0
"""Prior deviation of the axial force of contacts on the axis: half the largest lateral force."""
_UNFELT_N = 0.01
"""Deviation of the part of a force that no reading depends on: next to nothing, as it is not
stated."""
_IN_PLANE = 2.0 / np.pi
"""(1 / f √(2π))² over (1 / 2f)²: of the densities 1 / (2π f F), with the Gaussian integral over
both directions across a segment, and 1 / 2F with that over one."""

RADIUS_MEAN = 2.0 / 3.0
"""Where a surface is touched, from the axis, as a share of its radius: anywhere within it, the
farther out the likelier. Plates and cables stand out by different amounts, and a tool may reach
between them."""
RADIUS_STD = 18.0**-0.5
"""Standard deviation of the same."""

_SMALLEST_LATERAL_N = 0.05
"""Lateral forces count as no smaller where something is divided by them or scales with them."""
GRID_POINTS = 33
"""Number of points of a segment's grid, on which the place of a contact is integrated."""
_GRID_HALF_WIDTH_STD = 5.0
"""Standard deviations of the place that the grid covers to each side."""
_BEYOND_ENDS_STD = 3.0
"""Deviations of r f_x / f by which s is looked for beyond the ends of a segment."""
_TINY_N = 1e-6
"""Larger than what the exporter to ONNX takes for zero, and leaves out."""


class ContactPosterior(NamedTuple):
    """One contact on each of N segments, for B samples, on grids of K places.

    Forces are along the axes that a segment has at the command.

    Attributes:
        log_evidence: (B, N) of a contact on this segment, with the prior density of its place.
        chi2_gain: (B, N) by how much the best place lowers χ².
        line_m: (B, N, 1, K) the grid of s.
        weight: (B, N, 1, K) probabilities of the grid's places.
        place_m, place_variance_m2: (B, N, 1, K) places on the segment, and what is unknown of them
            beside the grid.
        force_n: (B, N, 3, K).
        covariance_n2: (B, N, 9, K) of the force.
        lateral_squared_n2, lateral_variance_n2: (B, N, 1, K) of the force across the segment.
    """

    log_evidence: Tensor
    chi2_gain: Tensor
    line_m: Tensor
    weight: Tensor
    place_m: Tensor
    place_variance_m2: Tensor
    force_n: Tensor
    covariance_n2: Tensor
    lateral_squared_n2: Tensor
    lateral_variance_n2: Tensor


class _Without(NamedTuple):
    """What is left beside unknown moments, and what they explain by themselves.

    Attributes:
        table: (B, N, 6, 8) as in `SegmentWrench`.
        gain, log_evidence: (B, N) of the moments, against none.
    """

    table: Tensor
    gain: Tensor
    log_evidence: Tensor


class PosteriorOfContact(nn.Module):
    """`ContactPosterior` from fits of wrenches.

    Args:
        touched: where the segments can be touched. Its friction is taken as the deviation of
            axial over lateral forces.
        felt_across: (N, 2, 2) or (2, 2) projections of forces across the segments, along y and z,
            to what makes a torque in some pose. Where that is one direction alone, forces are in
            its plane: the density of a force f in it is 1 / 2F, up to the largest F.
    """

    def __init__(self, touched: TouchedPlaces, felt_across: Matrix) -> None:
        touched_m, radius_m, friction = touched
        super().__init__()
        self.on_surface = friction > 0.0
        self.friction = friction
        radius = radius_m[:, None, None]
        self.middle_m = float(touched_m.mean())
        low = touched_m[:, :1, None]
        high = touched_m[:, 1:, None]
        offset = _BEYOND_ENDS_STD * friction * radius * np.hypot(RADIUS_MEAN, RADIUS_STD)
        self.mean_radius_m = constant(RADIUS_MEAN * radius)
        self.radius_variance_m2 = constant(RADIUS_STD**2 * radius**2)
        self.radius_square_m2 = constant((RADIUS_STD**2 + RADIUS_MEAN**2) * radius**2)
        self.torsion_share_m2 = constant((friction * radius) ** 2)
        self.beside_share_m2 = constant((friction**2 * radius) ** 2)
        # of a moment beside the place, across the force of a wrench: (f_y, f_z) to (-f_z, f_y)
        self.beside = constant(_rows_beside())
        self.ends_m = constant(np.concatenate([low, high], axis=1))
        self.first_m = constant(low - offset)
        self.last_m = constant(high + offset)
        self.shares = constant(np.linspace(0.0, 1.0, GRID_POINTS))
        self.coefficients = (-1, len(touched_m), len(_ENTRIES) + 3, 2)
        self.matrices = (-1, len(touched_m), 3, 3, GRID_POINTS)
        fixed, by_place = _rows_of_fits()
        self.fixed_rows = constant(fixed)
        self.by_place_rows = constant(by_place)
        self.axial_precision = constant(np.full((1, 1, 1), AXIAL_STD_N**-2))
        prior = np.zeros((*felt_across.shape[:-2], 3, 3))
        prior[..., 1:, 1:] = LARGEST_N**-2 * felt_across + _UNFELT_N**-2 * (
            np.eye(2) - felt_across
        )
        entries = prior.reshape(*prior.shape[:-2], 9)[..., _ENTRIES]
        no_pull = np.zeros((*prior.shape[:-2], 3))
        self.prior = constant(np.concatenate([entries, no_pull], axis=-1)[..., None])
        in_plane = np.linalg.det(felt_across) < 0.5
        self.has_plane = bool(in_plane.any())
        self.in_plane = constant(in_plane[..., None, None].astype(float))
        self.is_axial = constant(np.append(_ENTRIES == 0, np.zeros(3))[:, None].astype(float))
        total_m = float((touched_m[:, 1] - touched_m[:, 0]).sum())
        # of the place, of the direction, and of the magnitude: 1 / (2π f F L), the force in its
        # plane; with 2π of the Gaussian integral over the lateral force
        self.log_prior = -float(np.log(LARGEST_N * total_m))

    def forward(self, wrench: SegmentWrench, fit: WrenchFit) -> ContactPosterior:
        """The posterior; `fit` made the wrench."""
        if not self.on_surface:
            line = fit.line(wrench.covariance, wrench.mean)
            return self._posterior(wrench.table[:, :, :6], line, None)
        strength = fit.strength(wrench)
        per_force2 = _within(strength.per_force2 + self.middle_m**2 * strength.per_moment2)
        levers, torsion = wrench.table.split((6, 1), dim=2)
        *_, self_product, along = torsion.split((6, 1, 1), dim=3)
        variance = self.torsion_share_m2 / per_force2
        twisted = _without(levers, torsion, self_product, along, variance)
        beside = self.beside @ wrench.mean
        square = (beside * beside).sum(2, keepdim=True).clamp(min=_TINY_N**2)
        beside = beside * torch.rsqrt(square)
        row = beside.transpose(2, 3) @ twisted.table
        self_product = row[..., :6] @ beside
        variance = self.beside_share_m2 / per_force2
        constrained = _without(twisted.table, row, self_product, row[..., 7:8], variance)
        line = fit.refined_line(constrained.table, per_force2 * self.friction**-2)
        posterior = self._posterior(constrained.table, line, strength)
        return posterior._replace(
            log_evidence=posterior.log_evidence + twisted.log_evidence + constrained.log_evidence,
            chi2_gain=posterior.chi2_gain + twisted.gain + constrained.gain,
        )

    def _posterior(
        self, table: Tensor, line: ContactLine, strength: Strength | None
    ) -> ContactPosterior:
        """The fits: f = V (A + s B) P τ with V⁻¹ = (A + s B) P (A + s B)' + prior."""
        width = _GRID_HALF_WIDTH_STD * line.std_m
        # of what lies off the segment the nearest part
        low = torch.minimum(line.place_m - width, self.last_m - line.std_m)
        high = torch.maximum(line.place_m + width, self.first_m + line.std_m)
        low = torch.maximum(low, self.first_m)
        span = torch.minimum(high, self.last_m) - low
        s = low + span * self.shares
        squared_s = s * s
        axial_precision: Tensor = self.axial_precision
        if strength is not None:
            per_force2 = _within(strength.per_force2 + squared_s * strength.per_moment2)
            axial_precision = per_force2 * self.friction**-2
        flat = table.flatten(2)
        by_place = (flat @ self.by_place_rows).reshape(*self.coefficients)
        rows = (flat @ self.fixed_rows)[..., None] + self.prior + axial_precision * self.is_axial
        rows = rows + by_place @ torch.cat([s, squared_s], dim=2)
        next_next, last_last, next_last, last_next, first_row, pull = rows.split(
            (9, 9, 9, 9, 3, 3), dim=2
        )
        # of a symmetric 3 x 3 matrix M the inverse is C / det M with the cofactors
        # C_ij = M_(i+1)(j+1) M_(i+2)(j+2) - M_(i+1)(j+2) M_(i+2)(j+1), indices modulo 3
        cofactors = next_next * last_last - next_last * last_next
        determinant = (first_row * cofactors[:, :, :3]).sum(2, keepdim=True)
        covariance = cofactors / determinant
        matrix = covariance.reshape(*self.matrices)
        force = (matrix * pull[:, :, None]).sum(3)
        gain = (force * pull).sum(2, keepdim=True)
        axial, lateral = force.split((1, 2), dim=2)
        # a force of zero has no direction: any will do
        lateral = lateral + _TINY_N
        squared = (lateral * lateral).sum(2, keepdim=True)
        swept = (matrix[:, :, 1:, 1:] * lateral[:, :, None]).sum(3)
        variance = (swept * lateral).sum(2, keepdim=True) / squared
        # the density 1 / (2π f F) of a force has no pole where f is known to its deviation only
        density = torch.maximum(squared, variance)
        if self.has_plane:
            density = density + self.in_plane * (_IN_PLANE * _UNFELT_N**2 - density)
        scale = determinant * density / axial_precision
        log_density = 0.5 * (gain - torch.log(scale))

        step = span / (GRID_POINTS - 1)
        place = s
        place_variance = step**2 / 12.0 + 0.0 * s
        if self.on_surface:
            per_squared = 1.0 / (squared + _SMALLEST_LATERAL_N**2)
            shift = axial * torch.sqrt(per_squared)
            spread = covariance[:, :, :1] * per_squared
            place = s - self.mean_radius_m * shift
            place_variance = (
                place_variance
                + self.radius_variance_m2 * shift**2
                + self.radius_square_m2 * spread
            )
            # the place is on the segment: the share of its distribution that is there
            beyond = (self.ends_m - place) * torch.rsqrt(2.0 * place_variance)
            below, above = error_function(beyond).split(1, dim=2)
            log_density = log_density + torch.log((0.5 * (above - below)).clamp(min=1e-12))
        log_evidence = torch.logsumexp(log_density, dim=3, keepdim=True) + torch.log(step)
        return ContactPosterior(
            log_evidence=log_evidence[:, :, 0, 0] + self.log_prior,
            chi2_gain=gain.amax((2, 3)),
            line_m=s,
            weight=torch.softmax(log_density, dim=3),
            place_m=place,
            place_variance_m2=place_variance,
            force_n=force,
            covariance_n2=covariance,
            lateral_squared_n2=squared,
            lateral_variance_n2=variance,
        )


def _without(
    levers: Tensor, row: Tensor, own: Tensor, along: Tensor, variance: Tensor
) -> _Without:
    """Take an unknown moment, of a variance, out of the torques (Woodbury).

    Of the products with P are given: `row` (B, N, 1, 8) of the moment with all, `own` with itself
    and `along` with the torques, (B, N, 1, 1).
    """
    occam = 1.0 + variance * own
    share = variance / occam
    gain = (share * along * along).sum((2, 3))
    return _Without(
        levers - row[..., :6].transpose(2, 3) * share * row,
        gain,
        0.5 * (gain - torch.log(occam).sum((2, 3))),
    )


def _rows_beside() -> Matrix:
    """(6, 5): from the unknowns of a wrench to levers by a moment across its force."""
    rows = np.zeros((6, 5))
    for unknown in (1, 3):
        rows[5, unknown] = 1.0
        rows[4, unknown + 1] = -1.0
    return rows


def _within(per_force2: Tensor) -> Tensor:
    """Inverse squares of lateral forces that are expected."""
    return per_force2.clamp(LARGEST_N**-2, _SMALLEST_LATERAL_N**-2)


_AROUND = np.arange(3)
_NEXT = (_AROUND + 1) % 3
_LAST = (_AROUND + 2) % 3
_ENTRIES = np.concatenate(
    [
        (3 * rows[:, None] + columns).reshape(-1)
        for rows, columns in ((_NEXT, _NEXT), (_LAST, _LAST), (_NEXT, _LAST), (_LAST, _NEXT))
    ]
    + [_AROUND]
)
"""Entries of a 3 x 3 matrix: the four of each of its nine cofactors, and then its first row.

Of the cofactor in row i and column j they are, with the next number i + 1 and the last i + 2, both
modulo 3: (next, next), (last, last), (next, last) and (last, next).
"""


def _rows_of_fits() -> tuple[Matrix, Matrix]:
    """(48, 42) and (48, 84): from the table (6, 8) of the levers A and B to the rows of a fit.

    The rows are the `_ENTRIES` of (A + s B) P (A + s B)', and (A + s B) P τ, first without s, and
    then the factors of s and s².
    """
    powers = np.zeros((3, 6, 8, 3, 3))
    pulls = np.zeros((3, 6, 8, 3))
    for i in range(3):
        for j in range(3):
            powers[0, i, j, i, j] = 1.0
            powers[1, i, 3 + j, i, j] = 1.0
            powers[1, 3 + i, j, i, j] = 1.0
            powers[2, 3 + i, 3 + j, i, j] = 1.0
        pulls[0, i, 7, i] = 1.0
        pulls[1, 3 + i, 7, i] = 1.0
    entries = powers.reshape(3, 48, 9)[..., _ENTRIES]
    rows = np.concatenate([entries, pulls.reshape(3, 48, 3)], axis=2)
    return rows[0], np.stack([rows[1], rows[2]], axis=-1).reshape(48, -1)
