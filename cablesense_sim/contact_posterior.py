"""The posterior of one contact on an arm, sample by sample, compiled: see `contact_location`."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_sim.compiled import compiled
from cablesense_sim.contact_force import (
    BOUND_STD,
    SOFT,
    Force,
    Prior,
    add_friction,
    axial_bound,
    best_force,
    bounded,
    fixed_twist,
    free_twist,
    of_sum,
    polynomials,
    true_torques,
    turned,
    weighted_products,
)
from cablesense_sim.contact_intervals import FINE, Grid, bound_region, compare, summarise, weigh
from cablesense_sim.contact_location import Location, TorqueBalance

_COARSE, _STEPS = 9, 5
"""Places of the first grid, and most Gauss-Newton steps from there to the final one. The first is
coarse: the gain is smooth over a segment, however small the noise is."""
_RUBBED = 2
"""Times that friction is linearised at the force found before."""
TWISTS = 5
"""Ranges of the friction across an arm. Its moment is a factor of that of the axial force, so the
posterior is linear in one range only."""
_TWIST_STD = 0.3
"""Deviation of that friction in a range, as a share of its bound: the ranges together have the
deviation of a soft uniform distribution."""
_CONVERGED = 0.02
"""A step that is this fraction of the place's deviation is the last."""
_FINE_REACH = 4.5
"""Standard deviations of a place on each side that the final grid covers."""
_LARGEST_SINE = 0.9
"""Of the angle between the normal and the lateral force."""
_OUT_OF_QUESTION = 14.0
"""Log odds below the best at which a segment, or a range of friction on it, gets no grid: a
probability below 1e-6."""
_OPEN = 8.0
"""Deviation, in bounds, of the normal prior that keeps the force of a straight arm finite."""


def unfilled(count: int, segments: int) -> Location:
    """A location of `count` samples, to be filled by `locate_each`."""
    number, pair, vector = (count,), (count, 2), (count, 3)
    return Location(
        probability=np.empty((count, segments + 1)),
        segment=np.empty(count, dtype=np.int64),
        place_m=np.empty(number),
        place_ci95_m=np.empty(pair),
        region_segment=np.empty(pair, dtype=np.int64),
        region_m=np.empty(pair),
        force_n=np.empty(vector),
        covariance=np.empty((count, 4, 4)),
        magnitude_ci95_n=np.empty(pair),
        moment_n_m=np.empty(pair),
        moment_std_n_m=np.empty(pair),
        log_evidence=np.empty(number),
        chi2=np.empty(number),
    )


class _Fit(NamedTuple):
    """The best place on a segment.

    Attributes:
        place_m, deviation_m: of it.
        log_evidence: by Laplace's approximation, up to the prior's volume.
        side_y_m, side_z_m: from the axis to the touched surface, along the lateral force.
        twist_gain, twist_log: by how much a moment about the axis lowers chi², and its log share
            of the evidence.
    """

    place_m: float
    deviation_m: float
    log_evidence: float
    side_y_m: float
    side_z_m: float
    twist_gain: float
    twist_log: float


@compiled
def locate_each(balance: TorqueBalance, prior: Prior, found: Location) -> None:
    """Fill the posteriors of B samples, whose arrays are contiguous."""
    count, segments, _, joints = balance.by_place.shape
    torques, gram, pull = np.empty((7, joints)), np.empty((7, 7)), np.empty(7)
    ranges = TWISTS if prior.radius_m >= 0.0 else 1
    shape = np.zeros((segments, ranges, 9, 3))
    evidence, turn = np.empty(segments), np.empty((segments, 3, 3))
    fits = [_Fit(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0) for _ in range(segments * ranges)]
    filled = np.empty(segments, dtype=np.bool_)
    places = ranges * FINE
    grid = Grid(
        np.empty((segments, places)),
        np.empty((segments, places)),
        np.empty((segments, places)),
        np.zeros((segments, places, 3)),
        np.zeros((segments, places, 9)),
        np.zeros((segments, places)),
        np.zeros((segments, places)),
        np.zeros((segments, places, 2)),
        np.zeros((segments, places, 2)),
    )
    log_volume = math.log(prior.largest_n * (prior.reach_m[:, 1] - prior.reach_m[:, 0]).sum())
    for b in range(count):
        chi2 = 0.0
        for n in range(segments):
            true_torques(balance, b, n, turn[n], torques)
            chi2 = weighted_products(torques, balance, b, gram, pull)
            evidence[n] = _best_places(gram, pull, n, prior, shape[n], fits) - log_volume
        least, best, gain = evidence.max() - _OUT_OF_QUESTION, segments, 0.0
        for n in range(segments):
            filled[n] = evidence[n] >= least
            if not filled[n]:
                continue
            one = _fill(shape[n], fits, turn[n], n, prior, grid)
            evidence[n] = weigh(grid, n) - log_volume
            if best == segments or evidence[n] > evidence[best]:
                best, gain = n, one
        found.chi2[b] = chi2 - gain
        compare(evidence, found, b)
        summarise(grid, best, prior.largest_n, found, b)
        bound_region(grid, filled, found.probability[b], found, b)


@compiled
def _best_places(
    gram: Array, pull: Array, n: int, prior: Prior, shape: Array, fits: list[_Fit]
) -> float:
    """The best place on segment n, for every range of friction; gives the log evidence.

    Fills the polynomials. Friction acts at the touched surface.
    """
    low, high = prior.reach_m[n, 0], prior.reach_m[n, 1]
    surface, ranges = prior.radius_m >= 0.0, len(shape)
    polynomials(gram, pull, shape[0])
    axial, beyond = prior.axial_std_n**-2, 0.0
    if surface:
        axial = axial_bound(prior, prior.largest_n) ** -2
        beyond = prior.radius_m * prior.friction * (1.0 + SOFT)  # friction shifts it thus far
    s, most = low, -np.inf
    for k in range(_COARSE):
        tried = low - beyond + (high - low + 2.0 * beyond) * k / (_COARSE - 1)
        gain = best_force(shape[0], axial, tried).gain
        if gain > most:
            s, most = tried, gain
    s, deviation = _refined(
        gram, pull, shape[0], axial, s, low - beyond, high + beyond, high - low
    )
    force = best_force(shape[0], axial, s)
    if not surface:
        evidence = _evidence(force, axial, deviation)
        fits[n] = _Fit(s, deviation, evidence, 0.0, 0.0, 0.0, 0.0)
        return evidence
    total, top = 0.0, -np.inf
    for k in range(ranges):
        across = 2.0 * k / (ranges - 1) - 1.0
        one = _rubbed(gram, pull, across, force, s, n, prior, shape[k])
        fits[n * ranges + k] = one
        if one.log_evidence > top:
            total, top = total * math.exp(top - one.log_evidence), one.log_evidence
        total += math.exp(one.log_evidence - top)
    return top + math.log(total)


@compiled
def _rubbed(
    gram: Array,
    pull: Array,
    across: float,
    force: Force,
    s: float,
    n: int,
    prior: Prior,
    shape: Array,
) -> _Fit:
    """The best place near another with its force, in a range of the friction across the arm.

    `across` is the middle of the range, as a share of the bound. Fills the polynomials.
    """
    low, high, radius = prior.reach_m[n, 0], prior.reach_m[n, 1], prior.radius_m
    own_gram, own_pull = np.empty_like(gram), np.empty_like(pull)
    side_y, side_z, deviation, twist_gain, twist_log, axial = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    # the normal force is beside the lateral one, by the friction across
    sine = min(max(across * prior.friction, -_LARGEST_SINE), _LARGEST_SINE)
    cosine = math.sqrt(1.0 - sine * sine)
    for _ in range(_RUBBED):
        lateral = max(math.hypot(force.y, force.z), 1e-12)
        bound = axial_bound(prior, lateral)
        y, z = force.y / lateral, force.z / lateral
        side_y, side_z = radius * (cosine * y + sine * z), radius * (cosine * z - sine * y)
        ratio = min(max(force.x / lateral, -prior.friction), prior.friction)
        turns_y, turns_z = ratio * (y * sine / cosine - z), ratio * (z * sine / cosine + y)
        own_gram[:], own_pull[:] = gram, pull
        fixed_gain = fixed_twist(own_gram, own_pull, -sine * radius * lateral)
        std_n_m = _TWIST_STD * radius * bound
        twist_gain, twist_log = free_twist(own_gram, own_pull, 0, turns_y, turns_z, std_n_m)
        twist_gain, twist_log = twist_gain + fixed_gain, twist_log + 0.5 * fixed_gain
        add_friction(own_gram, own_pull, 0, side_y, side_z)
        polynomials(own_gram, own_pull, shape)
        axial, s = (BOUND_STD * bound) ** -2, min(max(s, low), high)
        s, deviation = _refined(own_gram, own_pull, shape, axial, s, low, high, high - low)
        force = best_force(shape, axial, s)
    twist_log -= math.log(TWISTS)
    evidence = _evidence(force, axial, deviation) + twist_log
    return _Fit(s, deviation, evidence, side_y, side_z, twist_gain, twist_log)


@compiled
def _evidence(force: Force, axial: float, deviation: float) -> float:
    """The log evidence by a best force and the deviation of its place, by Laplace's approximation.

    It is not bounded by the largest force, which another place on the segment may not exceed.
    """
    lateral, spread = _lateral(force)
    density = _log_density(force, math.sqrt(axial), lateral, spread, np.inf)
    return density + math.log(deviation * math.sqrt(2.0 * math.pi))


@compiled
def _lateral(force: Force) -> tuple[float, float]:
    """The lateral force, and its standard deviation along itself."""
    lateral = math.hypot(force.y, force.z)
    y, z = (force.y / lateral, force.z / lateral) if lateral > 0.0 else (1.0, 0.0)
    return lateral, math.sqrt(y * y * force.yy + 2.0 * y * z * force.yz + z * z * force.zz)


@compiled
def _log_density(
    force: Force, axial: float, lateral: float, spread: float, largest_n: float
) -> float:
    """The log density of a place, up to the prior of places and magnitudes.

    `axial` is √2π times the prior density of the axial force. That of magnitude and direction is
    uniform; near zero the noise is the scale of a force.
    """
    beyond = max(lateral - largest_n, 0.0) / spread
    volume = force.determinant * (lateral * lateral + spread * spread)
    return 0.5 * (force.gain + math.log(axial * axial / volume) - beyond * beyond)


@compiled
def _refined(
    gram: Array,
    pull: Array,
    shape: Array,
    axial: float,
    s: float,
    low: float,
    high: float,
    range_m: float,
) -> tuple[float, float]:
    """The best place near another one by Gauss-Newton steps, and its standard deviation, m.

    The best force for a place leaves a residual that only the place can lower. Before the tensions
    are known a place is known to the segment's range.
    """
    deviation = range_m
    for _ in range(_STEPS):
        f = best_force(shape, axial, s)
        across_x = _across(gram[3:6, 0], gram[3:6, 3], f, s)
        across_y = _across(gram[3:6, 1], gram[3:6, 4], f, s)
        across_z = _across(gram[3:6, 2], gram[3:6, 5], f, s)
        left = f.x * (pull[3] - across_x) + f.y * (pull[4] - across_y) + f.z * (pull[5] - across_z)
        own = range_m**-2
        own += f.x * f.x * gram[3, 3] + f.y * f.y * gram[4, 4] + f.z * f.z * gram[5, 5]
        own += 2.0 * (f.x * (f.y * gram[3, 4] + f.z * gram[3, 5]) + f.y * f.z * gram[4, 5])
        own -= across_x * (f.xx * across_x + 2.0 * (f.xy * across_y + f.xz * across_z))
        own -= f.yy * across_y**2 + 2.0 * f.yz * across_y * across_z + f.zz * across_z**2
        deviation = 1.0 / math.sqrt(own)
        before = s
        s = min(max(s + left / own, low), high)
        if abs(s - before) < _CONVERGED * deviation:
            break
    return s, deviation


@compiled
def _across(by_force: Array, by_place: Array, f: Force, s: float) -> float:
    """Information that the place shares with a component of the force.

    The arrays (3,) are products of the place's torques with those of the component.
    """
    return (
        f.x * (by_force[0] + s * by_place[0])
        + f.y * (by_force[1] + s * by_place[1])
        + f.z * (by_force[2] + s * by_place[2])
    )


@compiled
def _fill(shape: Array, fits: list[_Fit], turn: Array, n: int, prior: Prior, grid: Grid) -> float:
    """Fill the grid of segment n; gives the largest gain."""
    ranges, gain, least = len(shape), -np.inf, -np.inf
    for r in range(ranges):
        least = max(least, fits[n * ranges + r].log_evidence - _OUT_OF_QUESTION)
    for r in range(ranges):
        fit, begin = fits[n * ranges + r], r * FINE
        if fit.log_evidence < least:
            grid.log_density[n, begin : begin + FINE] = -np.inf
            grid.place_m[n, begin : begin + FINE] = fit.place_m
        else:
            gain = max(gain, _fill_range(shape[r], fit, turn, n, begin, prior, grid))
    return gain


@compiled
def _fill_range(
    shape: Array, fit: _Fit, turn: Array, n: int, first: int, prior: Prior, grid: Grid
) -> float:
    """Fill the grid of segment n from place `first` on; gives the largest gain."""
    surface, side = prior.radius_m >= 0.0, (fit.side_y_m, fit.side_z_m)
    axial, root, most = prior.axial_std_n**-2, 1.0 / prior.axial_std_n, -np.inf
    begin = max(prior.reach_m[n, 0], fit.place_m - _FINE_REACH * fit.deviation_m)
    end = min(prior.reach_m[n, 1], fit.place_m + _FINE_REACH * fit.deviation_m)
    lateral, _ = _lateral(best_force(shape, axial, begin))
    for i in range(FINE):
        k, s = first + i, begin + (end - begin) * i / (FINE - 1)
        log_bound = fit.twist_log
        if surface:  # bounded by the lateral force, which hardly differs from place to place
            bound = axial_bound(prior, lateral)
            root = math.sqrt(2.0 * math.pi) / (2.0 * bound)
            force, log_share = bounded(best_force(shape, (_OPEN * bound) ** -2, s), bound)
            log_bound += log_share
        else:
            force = best_force(shape, axial, s)
        about_y, about_z = s * force.z + side[1] * force.x, s * force.y + side[0] * force.x
        grid.moment_n_m[n, k, 0], grid.moment_n_m[n, k, 1] = -about_y, about_z
        grid.moment_variance[n, k, 0] = of_sum(s, force.zz, side[1], force.xx, force.xz)
        grid.moment_variance[n, k, 1] = of_sum(s, force.yy, side[0], force.xx, force.xy)
        force = turned(force, turn)
        lateral, spread = _lateral(force)
        density = log_bound + _log_density(force, root, lateral, spread, prior.largest_n)
        most = max(most, force.gain)
        grid.place_m[n, k], grid.log_density[n, k] = s, density
        grid.lateral_n[n, k], grid.lateral_std_n[n, k] = lateral, spread
        f, mean, shared = force, grid.force_n[n, k], grid.covariance_n2[n, k]
        mean[0], mean[1], mean[2] = f.x, f.y, f.z
        for j, c in enumerate((f.xx, f.xy, f.xz, f.xy, f.yy, f.yz, f.xz, f.yz, f.zz)):
            shared[j] = c
    return most + fit.twist_gain
