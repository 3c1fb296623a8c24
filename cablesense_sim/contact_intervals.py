"""Means and intervals of a contact, from its posterior on a grid of places, compiled."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_sim.compiled import compiled
from cablesense_sim.contact_location import Location

FINE = 41
"""Places of a segment's grid."""
_NEGLIGIBLE = 1e-5
"""Weight of a place that adds nothing to an interval."""
_NORMAL_95 = 1.959964
_HALVED = 14
"""Bisections of a place: the last leaves a hundredth of a millimetre of a segment."""
_ROOTS, _PRECISE = 30, 0.005
"""Most steps towards an end of the magnitude's interval, and its error in standard deviations."""


class Grid(NamedTuple):
    """The final grids on N segments, of K places in all, for each range of friction one.

    Attributes:
        place_m, log_density, weight: (N, K), by range; weights of a segment have the sum 1.
        force_n: (N, K, 3).
        covariance_n2: (N, K, 9) of it, row by row.
        lateral_n, lateral_std_n: (N, K).
        moment_n_m, moment_variance: (N, K, 2).
    """

    place_m: Array
    log_density: Array
    weight: Array
    force_n: Array
    covariance_n2: Array
    lateral_n: Array
    lateral_std_n: Array
    moment_n_m: Array
    moment_variance: Array


@compiled
def weigh(grid: Grid, n: int) -> float:
    """Fill the weights of segment n; gives the log evidence, up to the prior's volume."""
    top, weight = grid.log_density[n].max(), grid.weight[n]
    weight[:] = np.exp(grid.log_density[n] - top)
    for first in range(0, len(weight), FINE):
        weight[first : first + FINE] *= grid.place_m[n, first + 1] - grid.place_m[n, first]
    total = weight.sum()
    weight /= total
    return top + math.log(total)


@compiled
def compare(evidence: Array, found: Location, b: int) -> None:
    """Probabilities of no contact and of a contact on each segment, equal before."""
    probability, top = found.probability[b], max(evidence.max(), 0.0)
    probability[0], probability[1:] = math.exp(-top), np.exp(evidence - top)
    found.log_evidence[b] = top + math.log(probability[1:].sum())
    probability /= probability.sum()
    found.segment[b] = probability.argmax()


@compiled
def summarise(grid: Grid, n: int, largest_n: float, found: Location, b: int) -> None:
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
                covariance[i + 1, j + 1] += weight[k] * grid.covariance_n2[n, k, 3 * i + j]
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
        found.magnitude_ci95_n[b, i] = _magnitude_n(grid, n, share, largest_n)


@compiled
def bound_region(
    grid: Grid, filled: NDArray[np.bool_], probability: Array, found: Location, b: int
) -> None:
    """The interval of the place over all segments, given that there is a contact."""
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
        for first in range(0, len(weight), FINE):
            start, apart = place_m[first], place_m[first + 1] - place_m[first]
            for k in range(first, first + FINE):
                if weight[k] > 0.0:
                    part = (at - start) / apart - (k - first) + 0.5
                    below += weight[k] * min(max(part, 0.0), 1.0)
        if below < share:
            low = at
        else:
            high = at
    return 0.5 * (low + high)


@compiled
def _magnitude_n(grid: Grid, n: int, share: float, largest_n: float) -> float:
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
    limit = max(least, largest_n)
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
def _share_below(grid: Grid, n: int, magnitude_n: float) -> tuple[float, float]:
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
