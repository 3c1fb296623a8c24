"""The fit of two contacts on an arm, sample by sample, compiled: see `locate_two`.

The products of the torques that contacts can make (`contact_force`) are computed once a sample.
Eight numbers describe a pair, both forces and both places, and the derivative of its torques by
them combines rows of these products. For given places the forces follow from linear equations, and
Gauss-Newton steps of the places start from every peak of a grid.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_sim.compiled import compiled, solve
from cablesense_sim.contact_force import (
    BOUND_STD,
    SOFT,
    add_friction,
    axial_bound,
    best_force,
    free_twist,
    true_torques,
    weigh_products,
)
from cablesense_sim.contact_location import (
    AXIAL_STD_N,
    LARGEST_N,
    ContactPair,
    Prior,
    TorqueBalance,
)

_ROWS = 7  # torques that describe a contact on one segment
_COARSE = 11  # places on each segment of the first grid
_STEPS = 40
"""Most Gauss-Newton steps from a start: a few where the places are determined, many along a
valley where they are not."""
_HALVINGS = 8  # most halvings of a step that does not lower chi²
_CONVERGED = 0.02  # a step that is this fraction of the places' deviations is the last
_BOUNDS = 3  # times that lateral forces bound the axial ones anew, from the largest force on
_SINGULAR = 1e-12  # share of an information below which rounding is all that is left of it


class _Pair(NamedTuple):
    """One pair of segments, with its forces and places as they are fitted."""

    products: Array  # (15, 15) of the torques of both contacts and of the environment's
    axial: Array  # (2,) information of the axial forces before the tensions
    low: Array  # (2,) ends of the places' ranges
    high: Array  # (2,)
    place: Array  # (2,)
    force: Array  # (6,) of both
    root: Array  # (8, 8) lower Cholesky factor of the information of forces, then places, at these
    slope: Array  # (2,) of half the gain by the places


def fit_each(balance: TorqueBalance, prior: Prior) -> ContactPair:
    """The most probable pairs on B samples, whose arrays are contiguous."""
    count = len(balance.torque_n_m)
    found = ContactPair(
        segments=np.empty((count, 2), dtype=np.int64),
        place_m=np.empty((count, 2)),
        place_std_m=np.empty((count, 2)),
        force_n=np.empty((count, 2, 3)),
        force_std_n=np.empty((count, 2, 3)),
        log_evidence=np.empty(count),
        chi2=np.empty(count),
    )
    rows = 2 * _ROWS + 1
    shapes = ((rows, rows), (2,), (2,), (2,), (2,), (6,), (8, 8), (2,))
    pair = _Pair(*(np.empty(shape) for shape in shapes))
    _fit_each(balance, prior, pair, found)
    return found


@compiled
def _fit_each(balance: TorqueBalance, prior: Prior, pair: _Pair, found: ContactPair) -> None:
    count, segments, _, joints = balance.by_place.shape
    torques, turn = np.empty((_ROWS * segments + 1, joints)), np.empty((segments, 3, 3))
    products, covariance = np.empty((len(torques), len(torques))), np.empty((8, 8))
    for b in range(count):
        for n in range(segments):
            true_torques(balance, b, n, turn[n], torques[_ROWS * n : _ROWS * (n + 1)])
        torques[-1] = balance.torque_n_m[b]
        weigh_products(torques, balance.precision[b], products)
        for first in range(segments - 1):
            for second in range(first + 1, segments):
                _select(products, first, second, prior, pair)
                gain, log_twist = _fit(pair), 0.0
                if prior.radius_m >= 0.0:
                    gain, log_twist = _rub(pair, first, second, prior)
                chi2 = pair.products[-1, -1] - gain
                covariance[:] = 0.0
                for i in range(8):
                    covariance[i, i] = 1.0
                solve(pair.root, covariance)
                evidence = 0.5 * (products[-1, -1] - chi2) + log_twist
                evidence += _log_volume(pair, covariance, prior)
                if second == 1 or evidence > found.log_evidence[b]:  # the first pair, or a better
                    found.log_evidence[b], found.chi2[b] = evidence, chi2
                    for k, n in enumerate((first, second)):
                        _state(pair, covariance, n, turn[n], k, found, b)


@compiled
def _select(products: Array, first: int, second: int, prior: Prior, pair: _Pair) -> None:
    """Take the torques and the ranges of two segments, from 0 on."""
    rows = np.full(2 * _ROWS + 1, len(products) - 1)
    for k, n in enumerate((first, second)):
        rows[_ROWS * k : _ROWS * (k + 1)] = np.arange(_ROWS * n, _ROWS * (n + 1))
        pair.low[k], pair.high[k] = prior.reach_m[n, 0], prior.reach_m[n, 1]
        pair.axial[k] = AXIAL_STD_N**-2
        if prior.radius_m >= 0.0:
            pair.axial[k] = (BOUND_STD * axial_bound(prior, LARGEST_N)) ** -2
            beyond = prior.radius_m * prior.friction * (1.0 + SOFT)  # friction shifts it thus far
            pair.low[k] -= beyond
            pair.high[k] += beyond
    for i in range(len(rows)):
        for j in range(len(rows)):
            pair.products[i, j] = products[rows[i], rows[j]]


@compiled
def _fit(pair: _Pair) -> float:
    """The best places from every peak of a grid; gives their gain."""
    gains = _grid_gains(pair)
    most, first, second = -np.inf, pair.low[0], pair.low[1]
    for i in range(_COARSE):
        for j in range(_COARSE):
            near = gains[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2]
            if gains[i, j] >= near.max():
                pair.place[0] = _grid_place(pair.low[0], pair.high[0], i)
                pair.place[1] = _grid_place(pair.low[1], pair.high[1], j)
                gain = _refine(pair)
                if gain > most:
                    most, first, second = gain, pair.place[0], pair.place[1]
    pair.place[0], pair.place[1] = first, second
    return _profile(pair)


@compiled
def _rub(pair: _Pair, first: int, second: int, prior: Prior) -> tuple[float, float]:
    """Let friction act at the surface, once the forces are known.

    Lateral forces bound the axial ones, which in turn show the lateral ones better. Gives the gain
    of the forces, and what the prior of moments about the axes makes of the log evidence.
    """
    for _ in range(_BOUNDS):
        for k in range(2):
            lateral = math.hypot(pair.force[3 * k + 1], pair.force[3 * k + 2])
            pair.axial[k] = (BOUND_STD * axial_bound(prior, lateral)) ** -2
        _refine(pair)
    log_twist = 0.0
    for k, n in enumerate((first, second)):
        x, y, z = pair.force[3 * k], pair.force[3 * k + 1], pair.force[3 * k + 2]
        lateral = max(math.hypot(y, z), 1e-12)
        bound = BOUND_STD * axial_bound(prior, lateral)
        ratio = min(max(x / lateral, -prior.friction), prior.friction) / lateral
        row, radius, side = _ROWS * k, prior.radius_m, prior.radius_m / lateral
        log_twist += free_twist(pair.products, row, -ratio * z, ratio * y, radius * bound)
        add_friction(pair.products, row, side * y, side * z)
        pair.low[k], pair.high[k] = prior.reach_m[n, 0], prior.reach_m[n, 1]
        pair.place[k] = min(max(pair.place[k], pair.low[k]), pair.high[k])
        pair.axial[k] = bound**-2
    return _refine(pair), log_twist


@compiled
def _grid_place(low: float, high: float, i: int) -> float:
    """Places of the grid are closer to one another at the ends, where the misfit has minima."""
    share = math.sin(0.5 * math.pi * i / (_COARSE - 1)) ** 2
    return low + share * (high - low)


@compiled
def _grid_gains(pair: _Pair) -> Array:
    """The gains (K, K) over places of the first contact, then of the second.

    For one place of the first contact, the torques that its force cannot explain leave a problem
    of a single contact.
    """
    products, others = pair.products, _ROWS + 1
    gains, left = np.empty((_COARSE, _COARSE)), np.empty((others, others))
    shared, explained = np.empty((3, others)), np.empty((3, others))
    for i in range(_COARSE):
        s = _grid_place(pair.low[0], pair.high[0], i)
        f = best_force(products, pair.axial[0], s)
        for j in range(others):
            for k in range(3):
                shared[k, j] = products[k, _ROWS + j] + s * products[k + 3, _ROWS + j]
            x, y, z = shared[0, j], shared[1, j], shared[2, j]
            explained[0, j] = f.xx * x + f.xy * y + f.xz * z
            explained[1, j] = f.xy * x + f.yy * y + f.yz * z
            explained[2, j] = f.xz * x + f.yz * y + f.zz * z
        for j in range(others):
            for k in range(others):
                left[j, k] = products[_ROWS + j, _ROWS + k]
                for component in range(3):
                    left[j, k] -= shared[component, j] * explained[component, k]
        for j in range(_COARSE):
            place = _grid_place(pair.low[1], pair.high[1], j)
            gains[i, j] = f.gain + best_force(left, pair.axial[1], place).gain
    return gains


@compiled
def _refine(pair: _Pair) -> float:
    """Gauss-Newton steps of the places within their ranges; gives the gain."""
    gain = _profile(pair)
    for _ in range(_STEPS):
        a, c, d = pair.root[6, 6], pair.root[7, 6], pair.root[7, 7]
        first, second = pair.place[0], pair.place[1]
        second_step = (pair.slope[1] - c * pair.slope[0] / a) / (d * d)
        first_step = (pair.slope[0] / a - c * second_step) / a
        # next to an end of its range a place stays, and the other one goes on alone
        if _held(first, pair.low[0], pair.high[0], first_step):
            first_step, second_step = 0.0, pair.slope[1] / (c * c + d * d)
        elif _held(second, pair.low[1], pair.high[1], second_step):
            first_step, second_step = pair.slope[0] / (a * a), 0.0
        first_step = min(max(first + first_step, pair.low[0]), pair.high[0]) - first
        second_step = min(max(second + second_step, pair.low[1]), pair.high[1]) - second
        small_first, small_second = _CONVERGED * math.hypot(1.0, c / d) / a, _CONVERGED / d
        if abs(first_step) < small_first and abs(second_step) < small_second:
            break
        share = 1.0
        for _ in range(_HALVINGS + 1):
            pair.place[0] = first + share * first_step
            pair.place[1] = second + share * second_step
            tried = _profile(pair)
            if tried >= gain:
                break
            share *= 0.5
        if tried < gain:
            pair.place[0], pair.place[1] = first, second
            return _profile(pair)
        gain = tried
    return gain


@compiled
def _held(place: float, low: float, high: float, step: float) -> bool:
    """Whether a place is at an end of its range and would leave it."""
    return (step < 0.0 and place <= low) or (step > 0.0 and place >= high)


@compiled
def _profile(pair: _Pair) -> float:
    """The forces that fit best at the places, and the root there; gives the gain."""
    products, root, force, place = pair.products, pair.root, pair.force, pair.place
    weighted = np.empty((6, len(products)))
    for i in range(6):
        at, s = _ROWS * (i // 3) + i % 3, place[i // 3]
        weighted[i] = products[at] + s * products[at + 3]
        force[i] = weighted[i, -1]
        for j in range(6):
            at = _ROWS * (j // 3) + j % 3
            root[i, j] = weighted[i, at] + place[j // 3] * weighted[i, at + 3]
    root[0, 0] += pair.axial[0]
    root[3, 3] += pair.axial[1]
    for row in range(6):
        _factorise(root, row)
    for i in range(6):
        for j in range(i):
            force[i] -= root[i, j] * force[j]
        force[i] /= root[i, i]
    gain = (force * force).sum()
    for i in range(5, -1, -1):
        for j in range(i + 1, 6):
            force[i] -= root[j, i] * force[j]
        force[i] /= root[i, i]
    root[6:], pair.slope[:] = 0.0, 0.0
    for i in range(6):
        k = i // 3
        at = _ROWS * k + i % 3 + 3
        pair.slope[k] += force[i] * products[at, -1]
        for j in range(6):
            root[6 + k, j] += force[i] * weighted[j, at]
            other = _ROWS * (j // 3) + j % 3 + 3
            root[6 + k, 6 + j // 3] += force[i] * products[at, other] * force[j]
    for k in range(2):
        pair.slope[k] -= (root[6 + k, :6] * force).sum()
        root[6 + k, 6 + k] += 12.0 / (pair.high[k] - pair.low[k]) ** 2
    for row in range(6, 8):
        _factorise(root, row)
    return gain


@compiled
def _factorise(root: Array, row: int) -> None:
    """A row of a lower Cholesky factor below the others, in place of that of the matrix."""
    own = left = root[row, row]
    for j in range(row):
        for k in range(j):
            root[row, j] -= root[row, k] * root[j, k]
        root[row, j] /= root[j, j]
        left -= root[row, j] ** 2
    # contacts at one place make the same torques; what the second adds is then unknown
    root[row, row] = math.sqrt(left if left > _SINGULAR * own else own)


@compiled
def _log_volume(pair: _Pair, covariance: Array, prior: Prior) -> float:
    """Volume of the posterior over that of the prior, by Laplace's approximation."""
    log_volume = 4.0 * math.log(2.0 * math.pi)
    for i in range(8):
        log_volume -= math.log(pair.root[i, i])
    total_m = (prior.reach_m[:, 1] - prior.reach_m[:, 0]).sum()
    for k in range(2):
        y, z = 3 * k + 1, 3 * k + 2
        variance = covariance[y, y] + covariance[z, z]
        square = pair.force[y] ** 2 + pair.force[z] ** 2
        disc = 2.0 * math.pi * math.sqrt(square + variance) * LARGEST_N
        log_volume -= math.log(disc * math.sqrt(2.0 * math.pi / pair.axial[k]) * total_m)
        log_volume -= 0.5 * max(math.sqrt(square) - LARGEST_N, 0.0) ** 2 / variance
    return log_volume


@compiled
def _state(
    pair: _Pair, covariance: Array, n: int, turn: Array, k: int, found: ContactPair, b: int
) -> None:
    """Write contact k, on segment n from 0 on, into row b, along the axes at the command."""
    found.segments[b, k] = n + 1
    found.place_m[b, k] = pair.place[k]
    found.place_std_m[b, k] = math.sqrt(covariance[6 + k, 6 + k])
    for axis in range(3):
        force = variance = 0.0
        for i in range(3):
            force += turn[i, axis] * pair.force[3 * k + i]
            for j in range(3):
                variance += turn[i, axis] * covariance[3 * k + i, 3 * k + j] * turn[j, axis]
        found.force_n[b, k, axis], found.force_std_n[b, k, axis] = force, math.sqrt(variance)
