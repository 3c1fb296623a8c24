"""The posterior of one contact, sample by sample, compiled: see `contact_location`.

Around the best place on each segment it is computed on a grid of places, which gives means and
intervals.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_sim.compiled import compiled
from cablesense_sim.contact_force import (
    RUBBED,
    TWISTS,
    Fit,
    Force,
    Rub,
    best_force,
    best_places,
    bounded,
    lateral_of,
    let_rub,
    log_density,
    shared,
    true_torques,
    weigh_products,
)
from cablesense_sim.contact_location import AXIAL_STD_N, LARGEST_N, Location, Prior, TorqueBalance

_FINE, _FINE_REACH = 41, 4.5
"""Places of a segment's grid, and standard deviations of a place on each side that it covers."""
_OUT_OF_QUESTION = 14.0
"""Log odds below the best at which a segment, or a range of friction on it, gets no grid: a
probability below 1e-6."""
_OPEN_END, _MOST_WIDER = 7.0, 4
"""A grid whose ends have a log density nearer than this to its highest is widened; it is filled at
most so often. Friction gives a place longer tails than those of a normal distribution."""
_ALIKE = 4
"""Places of a grid for which friction is linear near the same force."""
_OPEN = 8.0
"""Deviation, in bounds, of the normal prior that keeps the force of a straight arm finite."""
_NEGLIGIBLE = 1e-5  # weight of a place that adds nothing to an interval
_NORMAL_95 = 1.959964
_HALVED = 14  # bisections of a place: the last leaves a hundredth of a millimetre of a segment
_ROOTS, _PRECISE = 30, 0.005
"""Most steps towards an end of the magnitude's interval, and its error in standard deviations."""


class _Grid(NamedTuple):
    """The final grids on N segments, of K places in all, for each range of friction one."""

    place_m: Array  # (N, K), by range
    log_density: Array  # (N, K)
    weight: Array  # (N, K), of a segment with the sum 1
    force_n: Array  # (N, K, 3)
    covariance_n2: Array  # (N, K, 3, 3)
    lateral_n: Array  # (N, K)
    lateral_std_n: Array  # (N, K)
    moment_n_m: Array  # (N, K, 2)
    moment_variance: Array  # (N, K, 2)


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


@compiled
def locate_each(balance: TorqueBalance, prior: Prior, found: Location) -> None:
    """Fill the posteriors of B samples, whose arrays are contiguous."""
    count, segments, _, joints = balance.by_place.shape
    torques, products = np.empty((8, joints)), np.zeros((segments, 8, 8))
    rubbed = np.zeros((8, 8))
    ranges = TWISTS if prior.radius_m >= 0.0 else 1
    evidence, turn = np.empty(segments), np.empty((segments, 3, 3))
    none = best_force(rubbed, 1.0, 0.0)
    fits = [Fit(0.0, 0.0, 0.0, 0.0, none) for _ in range(segments * ranges)]
    filled = np.empty(segments, dtype=np.bool_)
    places = ranges * _FINE
    grid = _Grid(
        np.empty((segments, places)),
        np.empty((segments, places)),
        np.empty((segments, places)),
        np.zeros((segments, places, 3)),
        np.zeros((segments, places, 3, 3)),
        np.zeros((segments, places)),
        np.zeros((segments, places)),
        np.zeros((segments, places, 2)),
        np.zeros((segments, places, 2)),
    )
    log_volume = math.log(LARGEST_N * (prior.reach_m[:, 1] - prior.reach_m[:, 0]).sum())
    for b in range(count):
        torques[7] = balance.torque_n_m[b]
        for n in range(segments):
            true_torques(balance, b, n, turn[n], torques[:7])
            weigh_products(torques, balance.precision[b], products[n])
            evidence[n] = best_places(products[n], n, prior, rubbed, fits) - log_volume
        least, best = evidence.max() - _OUT_OF_QUESTION, segments
        for n in range(segments):
            filled[n] = evidence[n] >= least
            if not filled[n]:
                continue
            chi2 = _fill(products[n], rubbed, fits, turn[n], n, prior, grid)
            evidence[n] = _weigh(grid, n) - log_volume
            if best == segments or evidence[n] > evidence[best]:
                best, found.chi2[b] = n, chi2
        _compare(evidence, found, b)
        _summarise(grid, best, found, b)
        _bound_region(grid, filled, found.probability[b], found, b)


@compiled
def _fill(
    products: Array, rubbed: Array, fits: list[Fit], turn: Array, n: int, prior: Prior, grid: _Grid
) -> float:
    """Fill the grid of segment n; gives the least chi². `rubbed` is overwritten."""
    low, high, chi2, least = prior.reach_m[n, 0], prior.reach_m[n, 1], np.inf, -np.inf
    ranges = grid.place_m.shape[1] // _FINE
    for r in range(ranges):
        least = max(least, fits[n * ranges + r].log_evidence - _OUT_OF_QUESTION)
    for r in range(ranges):
        fit, first = fits[n * ranges + r], r * _FINE
        density = grid.log_density[n, first : first + _FINE]
        if fit.log_evidence < least:
            density[:] = -np.inf
            grid.place_m[n, first : first + _FINE] = fit.place_m
            continue
        begin = max(low, fit.place_m - _FINE_REACH * fit.deviation_m)
        end = min(high, fit.place_m + _FINE_REACH * fit.deviation_m)
        for _ in range(_MOST_WIDER):
            found = _fill_range(products, rubbed, fit, turn, n, first, begin, end, prior, grid)
            least_end, more = density.max() - _OPEN_END, 0.5 * (end - begin)
            closed = begin == low or density[0] < least_end, end == high or density[-1] < least_end
            if closed[0] and closed[1]:
                break
            begin = begin if closed[0] else max(low, begin - more)
            end = end if closed[1] else min(high, end + more)
        chi2 = min(chi2, found)
    return chi2


@compiled
def _fill_range(
    products: Array, rubbed: Array, fit: Fit, turn: Array, n: int, first: int, begin_m: float,
    end_m: float, prior: Prior, grid: _Grid,
) -> float:  # fmt: skip
    """Fill the grid of segment n from place `first` on, between two ends; gives the least chi²."""
    surface, chi2, f = prior.radius_m >= 0.0, np.inf, fit.force
    axial, root, log_prior = AXIAL_STD_N**-2, 1.0 / AXIAL_STD_N, 0.0
    rub = Rub(0.0, 0.0, 0.0, 0.0)
    to_x = turn[0, 0], turn[1, 0], turn[2, 0]
    to_y = turn[0, 1], turn[1, 1], turn[2, 1]
    to_z = turn[0, 2], turn[1, 2], turn[2, 2]
    for step in range(_FINE):
        k, s = first + step, begin_m + (end_m - begin_m) * step / (_FINE - 1)
        if surface:  # friction is linear near the force at the place before
            for _ in range(RUBBED if step == 0 else 1):
                if step % _ALIKE == 0:
                    rub = let_rub(products, fit.across, f, prior, rubbed)
                unbounded = best_force(rubbed, (_OPEN * rub.bound_n) ** -2, s)
                f, log_share = bounded(unbounded, rub.bound_n)
            root = math.sqrt(2.0 * math.pi) / (2.0 * rub.bound_n)
            log_prior = rub.log_share + log_share
        else:
            f = best_force(products, axial, s)
        around_y, around_z = (rub.side_z_m, 0.0, s), (rub.side_y_m, s, 0.0)
        grid.moment_n_m[n, k, 0] = -(rub.side_z_m * f.x + s * f.z)
        grid.moment_n_m[n, k, 1] = rub.side_y_m * f.x + s * f.y
        grid.moment_variance[n, k, 0] = shared(f, around_y, around_y)
        grid.moment_variance[n, k, 1] = shared(f, around_z, around_z)
        # along the axes at the commanded angles
        x, y, z = _along(f, to_x), _along(f, to_y), _along(f, to_z)
        yy, yz, zz = shared(f, to_y, to_y), shared(f, to_y, to_z), shared(f, to_z, to_z)
        force, covariance = grid.force_n[n, k], grid.covariance_n2[n, k]
        force[0], force[1], force[2] = x, y, z
        covariance[0, 0] = shared(f, to_x, to_x)
        covariance[0, 1] = covariance[1, 0] = shared(f, to_x, to_y)
        covariance[0, 2] = covariance[2, 0] = shared(f, to_x, to_z)
        covariance[1, 1], covariance[2, 2] = yy, zz
        covariance[1, 2] = covariance[2, 1] = yz
        lateral, spread = lateral_of(y, z, yy, yz, zz)
        grid.log_density[n, k] = log_prior + log_density(f, root, lateral, spread, LARGEST_N)
        grid.place_m[n, k] = s
        grid.lateral_n[n, k], grid.lateral_std_n[n, k] = lateral, spread
        chi2 = min(chi2, (rubbed if surface else products)[-1, -1] - f.gain)
    return chi2


@compiled
def _along(f: Force, axis: tuple[float, float, float]) -> float:
    return f.x * axis[0] + f.y * axis[1] + f.z * axis[2]


@compiled
def _weigh(grid: _Grid, n: int) -> float:
    """Fill the weights of segment n; gives the log evidence, up to the prior's volume."""
    top, weight = grid.log_density[n].max(), grid.weight[n]
    weight[:] = np.exp(grid.log_density[n] - top)
    for first in range(0, len(weight), _FINE):
        weight[first : first + _FINE] *= grid.place_m[n, first + 1] - grid.place_m[n, first]
    total = weight.sum()
    weight /= total
    return top + math.log(total)


@compiled
def _compare(evidence: Array, found: Location, b: int) -> None:
    """Probabilities of no contact and of a contact on each segment, equal before."""
    probability, top = found.probability[b], max(evidence.max(), 0.0)
    probability[0], probability[1:] = math.exp(-top), np.exp(evidence - top)
    found.log_evidence[b] = top + math.log(probability[1:].sum())
    probability /= probability.sum()
    found.segment[b] = probability.argmax()


@compiled
def _summarise(grid: _Grid, n: int, found: Location, b: int) -> None:
    """Means and intervals over the places of segment n, into row b."""
    weight, covariance = grid.weight[n], found.covariance[b]
    mean, off = np.zeros(4), np.empty(4)
    for k in range(len(weight)):
        mean[0] += weight[k] * grid.place_m[n, k]
        for i in range(3):
            mean[i + 1] += weight[k] * grid.force_n[n, k, i]
    covariance[:] = 0.0
    for k in range(len(weight)):
        off[0] = grid.place_m[n, k] - mean[0]
        for i in range(3):
            off[i + 1] = grid.force_n[n, k, i] - mean[i + 1]
            for j in range(3):
                covariance[i + 1, j + 1] += weight[k] * grid.covariance_n2[n, k, i, j]
        for i in range(4):
            for j in range(4):
                covariance[i, j] += weight[k] * off[i] * off[j]
    found.place_m[b], found.force_n[b] = mean[0], mean[1:]
    for i in range(2):
        moment = variance = 0.0
        for k in range(len(weight)):
            moment += weight[k] * grid.moment_n_m[n, k, i]
        for k in range(len(weight)):
            square = (grid.moment_n_m[n, k, i] - moment) ** 2
            variance += weight[k] * (grid.moment_variance[n, k, i] + square)
        found.moment_n_m[b, i], found.moment_std_n_m[b, i] = moment, math.sqrt(variance)
    for i in range(2):
        share = 0.975 if i else 0.025
        found.place_ci95_m[b, i] = _place(grid.place_m[n], weight, share)
        found.magnitude_ci95_n[b, i] = _magnitude_n(grid, n, share)


@compiled
def _bound_region(
    grid: _Grid, filled: NDArray[np.bool_], probability: Array, found: Location, b: int
) -> None:
    """The interval of the place over all segments, given that there is a contact."""
    if filled.sum() == 1:
        found.region_segment[b, :] = 1 + filled.argmax()
        found.region_m[b] = found.place_ci95_m[b]
        return
    touched = 0.0
    for n in range(len(filled)):
        touched += probability[n + 1] if filled[n] else 0.0
    for i in range(2):
        left, at, share = 0.975 if i else 0.025, 0, 0.0
        for n in range(len(filled)):
            if filled[n]:
                own = probability[n + 1] / touched
                at, share = n, min(left / own, 1.0)
                if own >= left:
                    break
                left -= own
        found.region_segment[b, i] = at + 1
        found.region_m[b, i] = _place(grid.place_m[at], grid.weight[at], share)


@compiled
def _place(place_m: Array, weight: Array, share: float) -> float:
    """The place below which a share of the weights lies, each spread over its own interval."""
    low, high = np.inf, -np.inf
    for k in range(len(weight)):
        if weight[k] > 0.0:
            low, high = min(low, place_m[k]), max(high, place_m[k])
    for _ in range(_HALVED):
        at, below = 0.5 * (low + high), 0.0
        for first in range(0, len(weight), _FINE):
            start, apart = place_m[first], place_m[first + 1] - place_m[first]
            for k in range(first, first + _FINE):
                if weight[k] > 0.0:
                    part = (at - start) / apart - (k - first) + 0.5
                    below += weight[k] * min(max(part, 0.0), 1.0)
        if below < share:
            low = at
        else:
            high = at
    return 0.5 * (low + high)


@compiled
def _magnitude_n(grid: _Grid, n: int, share: float) -> float:
    """The lateral force below which a share of the mixture of normal magnitudes lies.

    Magnitudes beyond the largest that is expected count only where all are. Newton's steps start
    at the quantile of a normal distribution with the mixture's moments.
    """
    mean, square, least, high = 0.0, 0.0, np.inf, 0.0
    for k in range(grid.weight.shape[1]):
        size, std, w = grid.lateral_n[n, k], grid.lateral_std_n[n, k], grid.weight[n, k]
        if w > _NEGLIGIBLE:
            least, high = min(least, size + 6.0 * std), max(high, size + 2.0 * std)
            mean += w * size
            square += w * (size * size + std * std)
    std = math.sqrt(max(square - mean * mean, 0.0))
    limit = max(least, LARGEST_N)
    share *= _share_below(grid, n, limit)[0]
    low, high = 0.0, min(high, limit)
    at = min(max(mean + (_NORMAL_95 if share > 0.5 else -_NORMAL_95) * std, low), high)
    for _ in range(_ROOTS):
        below, density = _share_below(grid, n, at)
        if below < share:
            low = at
        else:
            high = at
        last = at
        at += (share - below) / max(density, 1e-30)
        if not low <= at <= high:
            at = 0.5 * (low + high)
        if abs(at - last) < _PRECISE * std:
            break
    return at


@compiled
def _share_below(grid: _Grid, n: int, magnitude_n: float) -> tuple[float, float]:
    """The share of magnitudes below one, and their density there."""
    below, density = 0.0, 0.0
    for k in range(grid.weight.shape[1]):
        if grid.weight[n, k] > _NEGLIGIBLE:
            off = (magnitude_n - grid.lateral_n[n, k]) / grid.lateral_std_n[n, k]
            if off > 6.0:
                below += grid.weight[n, k]
            elif off > -6.0:
                below += grid.weight[n, k] * 0.5 * math.erfc(-off * math.sqrt(0.5))
                bell = math.exp(-0.5 * off * off)
                density += grid.weight[n, k] * bell / grid.lateral_std_n[n, k]
    return below, density / math.sqrt(2.0 * math.pi)
