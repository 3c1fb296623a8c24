"""The fit of two contacts on an arm, sample by sample, compiled: see `locate_two`.

The gram of the torques that contacts can make (`contact_force`) is computed once a sample. The
information of both forces is a polynomial in both places by blocks of it. For one place of the
first contact, the torques that its force cannot explain leave a problem of a single contact.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_sim.compiled import compiled
from cablesense_sim.contact_force import (
    BOUND_STD,
    SOFT,
    Prior,
    add_friction,
    axial_bound,
    best_force,
    free_twist,
    polynomials,
    products,
    pulled_by,
    true_torques,
)
from cablesense_sim.contact_location import ContactPair, TorqueBalance

_ROWS = 7
"""Torques that describe a contact on one segment."""
_COARSE = 11
"""Places on each segment of the first grid."""
_STEPS = 40
"""Most Gauss-Newton steps from a start: a few where the places are determined, many along a
valley where they are not."""
_HALVINGS = 8
"""Most halvings of a step that does not lower chi²."""
_CONVERGED = 0.02
"""A step that is this fraction of the places' deviations is the last."""
_BOUNDS = 3
"""Times that lateral forces bound the axial ones anew, from the largest force on."""
_SINGULAR = 1e-12
"""Share of an information below which rounding is all that is left of it."""


class _Pair(NamedTuple):
    """One pair of segments, with its forces and places as they are fitted.

    Attributes:
        gram, pull: (14, 14), (14,) of the torques of both contacts.
        axial: (2,) information of the axial forces before the tensions.
        low, high: (2,) ends of the places' ranges.
        place: (2,); force: (6,) of both.
        root: (8, 8) lower Cholesky factor of the information of forces, then places.
        inverse: (8, 8) of that factor.
        slope: (2,) of half the gain by the places.
    """

    gram: Array
    pull: Array
    axial: Array
    low: Array
    high: Array
    place: Array
    force: Array
    root: Array
    inverse: Array
    slope: Array


class _Grid(NamedTuple):
    """The first grid over both places, and room for the problem of the second contact alone.

    Attributes:
        gain: (K, K) over the places of the first, then of the second.
        gram, pull: (7, 7), (7,) of the second contact's torques, less what the first one explains.
        shape: (9, 3) polynomials of a single contact.
        near, solved: (3, 7) information that the first force shares with these torques, and the
            force that explains them.
    """

    gain: Array
    gram: Array
    pull: Array
    shape: Array
    near: Array
    solved: Array


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
    _fit_each(balance, prior, found)
    return found


@compiled
def _fit_each(balance: TorqueBalance, prior: Prior, found: ContactPair) -> None:
    count, segments, _, joints = balance.by_place.shape
    by_force_m, by_place, by_twist = balance.by_force_m, balance.by_place, balance.by_twist
    rows = _ROWS * segments
    torques, weighted, pulled = (
        np.empty((rows, joints)),
        np.empty((rows, joints)),
        np.empty(joints),
    )
    gram, pull, turn = np.empty((rows, rows)), np.empty(rows), np.empty((segments, 3, 3))
    pair = _Pair(
        np.empty((2 * _ROWS, 2 * _ROWS)),
        np.empty(2 * _ROWS),
        np.empty(2),
        np.empty(2),
        np.empty(2),
        np.empty(2),
        np.empty(6),
        np.zeros((8, 8)),
        np.zeros((8, 8)),
        np.empty(2),
    )
    grid = _Grid(
        np.empty((_COARSE, _COARSE)),
        np.empty((_ROWS, _ROWS)),
        np.empty(_ROWS),
        np.zeros((9, 3)),
        np.empty((3, _ROWS)),
        np.empty((3, _ROWS)),
    )
    for b in range(count):
        chi2 = pulled_by(balance.torque_n_m[b], balance.precision[b], pulled)
        for n in range(segments):
            own = torques[_ROWS * n : _ROWS * (n + 1)]
            true_torques(by_force_m[b], by_place[b], by_twist[b], n, turn[n], own)
        products(torques, balance.precision[b], pulled, weighted, gram, pull)
        for first in range(segments - 1):
            for second in range(first + 1, segments):
                _select(gram, pull, first, second, prior, pair)
                gain, twist_gain, log_twist = _fit(pair, grid), 0.0, 0.0
                if prior.radius_m >= 0.0:
                    gain, twist_gain, log_twist = _rub(pair, first, second, prior)
                evidence = _log_evidence(pair, gain, prior) + log_twist
                if second == 1 or evidence > found.log_evidence[b]:  # the first pair, or a better
                    found.log_evidence[b], found.chi2[b] = evidence, chi2 - gain - twist_gain
                    _state(pair, first, turn[first], 0, found, b)
                    _state(pair, second, turn[second], 1, found, b)


@compiled
def _select(gram: Array, pull: Array, first: int, second: int, prior: Prior, pair: _Pair) -> None:
    """Take the torques and the ranges of two segments, from 0 on."""
    for k in range(2):
        n = second if k else first
        pair.low[k], pair.high[k] = prior.reach_m[n, 0], prior.reach_m[n, 1]
        pair.axial[k] = prior.axial_std_n**-2
        if prior.radius_m >= 0.0:
            pair.axial[k] = (BOUND_STD * axial_bound(prior, prior.largest_n)) ** -2
            beyond = prior.radius_m * prior.friction * (1.0 + SOFT)  # friction shifts it thus far
            pair.low[k] -= beyond
            pair.high[k] += beyond
        for i in range(_ROWS):
            pair.pull[_ROWS * k + i] = pull[_ROWS * n + i]
            for j in range(_ROWS):
                pair.gram[_ROWS * k + i, j] = gram[_ROWS * n + i, _ROWS * first + j]
                pair.gram[_ROWS * k + i, _ROWS + j] = gram[_ROWS * n + i, _ROWS * second + j]


@compiled
def _fit(pair: _Pair, grid: _Grid) -> float:
    """The best places from every peak of a grid; gives their gain. `root` is of these."""
    _fill(pair, grid)
    most, first, second = -np.inf, pair.low[0], pair.low[1]
    for i in range(_COARSE):
        for j in range(_COARSE):
            if _is_peak(grid.gain, i, j):
                pair.place[0] = _grid_place(pair, 0, i)
                pair.place[1] = _grid_place(pair, 1, j)
                gain = _refine(pair)
                if gain > most:
                    most, first, second = gain, pair.place[0], pair.place[1]
    pair.place[0], pair.place[1] = first, second
    most = _profile(pair)
    _extend(pair)
    return most


@compiled
def _rub(pair: _Pair, first: int, second: int, prior: Prior) -> tuple[float, float, float]:
    """Let friction act at the surface, once the forces are known.

    Lateral forces bound the axial ones, which in turn show the lateral ones better. Gives the gain
    of the forces and that of moments about the axes, and the log share of these in the evidence.
    """
    for _ in range(_BOUNDS):
        for k in range(2):
            lateral = math.hypot(pair.force[3 * k + 1], pair.force[3 * k + 2])
            pair.axial[k] = (BOUND_STD * axial_bound(prior, lateral)) ** -2
        _refine(pair)
    twist_gain, log_twist = 0.0, 0.0
    for k in range(2):
        x, y, z = pair.force[3 * k], pair.force[3 * k + 1], pair.force[3 * k + 2]
        lateral = max(math.hypot(y, z), 1e-12)
        bound = BOUND_STD * axial_bound(prior, lateral)
        ratio = min(max(x / lateral, -prior.friction), prior.friction) / lateral
        gain, share = free_twist(
            pair.gram, pair.pull, _ROWS * k, -ratio * z, ratio * y, prior.radius_m * bound
        )
        twist_gain, log_twist = twist_gain + gain, log_twist + share
    for k in range(2):
        y, z = pair.force[3 * k + 1], pair.force[3 * k + 2]
        lateral, n = max(math.hypot(y, z), 1e-12), second if k else first
        side = prior.radius_m / lateral
        add_friction(pair.gram, pair.pull, _ROWS * k, side * y, side * z)
        pair.low[k], pair.high[k] = prior.reach_m[n, 0], prior.reach_m[n, 1]
        pair.place[k] = min(max(pair.place[k], pair.low[k]), pair.high[k])
        pair.axial[k] = (BOUND_STD * axial_bound(prior, lateral)) ** -2
    gain = _refine(pair)
    _extend(pair)
    return gain, twist_gain, log_twist


@compiled
def _grid_place(pair: _Pair, k: int, i: int) -> float:
    """Places of the grid are closer to one another at the ends, where the misfit has minima."""
    share = math.sin(0.5 * math.pi * i / (_COARSE - 1)) ** 2
    return float(pair.low[k] + share * (pair.high[k] - pair.low[k]))


@compiled
def _is_peak(gain: Array, i: int, j: int) -> bool:
    """Whether no neighbour on the grid has more gain."""
    for k in range(max(i - 1, 0), min(i + 2, _COARSE)):
        for m in range(max(j - 1, 0), min(j + 2, _COARSE)):
            if gain[k, m] > gain[i, j]:
                return False
    return True


@compiled
def _fill(pair: _Pair, grid: _Grid) -> None:
    """The gains of a grid of places."""
    for i in range(_COARSE):
        s = _grid_place(pair, 0, i)
        polynomials(pair.gram, pair.pull, grid.shape)
        f = best_force(grid.shape, pair.axial[0], s)
        for k in range(_ROWS):
            for j in range(3):
                grid.near[j, k] = pair.gram[j, _ROWS + k] + s * pair.gram[3 + j, _ROWS + k]
            x, y, z = grid.near[0, k], grid.near[1, k], grid.near[2, k]
            grid.solved[0, k] = f.xx * x + f.xy * y + f.xz * z
            grid.solved[1, k] = f.xy * x + f.yy * y + f.yz * z
            grid.solved[2, k] = f.xz * x + f.yz * y + f.zz * z
            grid.pull[k] = pair.pull[_ROWS + k] - (f.x * x + f.y * y + f.z * z)
        for k in range(_ROWS):
            for m in range(_ROWS):
                grid.gram[k, m] = pair.gram[_ROWS + k, _ROWS + m]
                for j in range(3):
                    grid.gram[k, m] -= grid.near[j, k] * grid.solved[j, m]
        polynomials(grid.gram, grid.pull, grid.shape)
        for j in range(_COARSE):
            t = _grid_place(pair, 1, j)
            grid.gain[i, j] = f.gain + best_force(grid.shape, pair.axial[1], t).gain


@compiled
def _refine(pair: _Pair) -> float:
    """Gauss-Newton steps of the places within their ranges; gives the gain.

    `force` and the rows of the forces in `root` are then of these places.
    """
    gain = _profile(pair)
    for _ in range(_STEPS):
        _extend(pair)
        a, c, d = pair.root[6, 6], pair.root[7, 6], pair.root[7, 7]
        first, second = pair.place[0], pair.place[1]
        std_second = 1.0 / d
        std_first = math.hypot(1.0, c / d) / a
        second_step = (pair.slope[1] - c * pair.slope[0] / a) / (d * d)
        first_step = (pair.slope[0] / a - c * second_step) / a
        # next to an end of its range a place stays, and the other one goes on alone
        if _held(pair, 0, first_step):
            first_step, second_step = 0.0, pair.slope[1] / (c * c + d * d)
        elif _held(pair, 1, second_step):
            first_step, second_step = pair.slope[0] / (a * a), 0.0
        first_step = min(max(first + first_step, pair.low[0]), pair.high[0]) - first
        second_step = min(max(second + second_step, pair.low[1]), pair.high[1]) - second
        if abs(first_step) < _CONVERGED * std_first and abs(second_step) < _CONVERGED * std_second:
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
def _held(pair: _Pair, k: int, step: float) -> bool:
    """Whether a place is at an end of its range and would leave it."""
    return (step < 0.0 and pair.place[k] <= pair.low[k]) or (
        step > 0.0 and pair.place[k] >= pair.high[k]
    )


@compiled
def _profile(pair: _Pair) -> float:
    """The forces that fit best at the places, and their rows of the root; gives the gain."""
    gram, root, force, gain = pair.gram, pair.root, pair.force, 0.0
    for a in range(2):
        s, p = pair.place[a], _ROWS * a
        for i in range(3):
            row = 3 * a + i
            for b in range(a + 1):
                t, q = pair.place[b], _ROWS * b
                for j in range(i + 1 if a == b else 3):
                    root[row, 3 * b + j] = (
                        gram[p + i, q + j]
                        + s * gram[p + i + 3, q + j]
                        + t * (gram[p + i, q + j + 3] + s * gram[p + i + 3, q + j + 3])
                    )
            if i == 0:
                root[row, row] += pair.axial[a]
            _eliminate(root, row)
            total = pair.pull[p + i] + s * pair.pull[p + i + 3]
            for j in range(row):
                total -= root[row, j] * force[j]
            force[row] = total / root[row, row]
            gain += force[row] * force[row]
    for i in range(5, -1, -1):
        for j in range(i + 1, 6):
            force[i] -= root[j, i] * force[j]
        force[i] /= root[i, i]
    return gain


@compiled
def _eliminate(root: Array, row: int) -> None:
    """One row of a Cholesky factor, in place of the row of the matrix."""
    for j in range(row):
        total = root[row, j]
        for k in range(j):
            total -= root[row, k] * root[j, k]
        root[row, j] = total / root[j, j]
    own = root[row, row]
    left = own
    for k in range(row):
        left -= root[row, k] * root[row, k]
    # contacts at one place make the same torques; what the second adds is then unknown
    root[row, row] = math.sqrt(left if left > _SINGULAR * own else own)


@compiled
def _extend(pair: _Pair) -> None:
    """The rows of the places in the root, and the slope, at the forces that fit best."""
    gram, root, force = pair.gram, pair.root, pair.force
    for a in range(2):
        row, p = 6 + a, _ROWS * a + 3
        x, y, z = force[3 * a], force[3 * a + 1], force[3 * a + 2]
        slope = x * pair.pull[p] + y * pair.pull[p + 1] + z * pair.pull[p + 2]
        for b in range(2):
            t = pair.place[b]
            for j in range(3):
                q = _ROWS * b + j
                shared = (
                    x * (gram[p, q] + t * gram[p, q + 3])
                    + y * (gram[p + 1, q] + t * gram[p + 1, q + 3])
                    + z * (gram[p + 2, q] + t * gram[p + 2, q + 3])
                )
                root[row, 3 * b + j] = shared
                slope -= shared * force[3 * b + j]
        pair.slope[a] = slope
        for b in range(a + 1):
            total = 0.0
            for i in range(3):
                q = _ROWS * b + 3 + i
                along = x * gram[p, q] + y * gram[p + 1, q] + z * gram[p + 2, q]
                total += along * force[3 * b + i]
            root[row, 6 + b] = total
        root[row, row] += 12.0 / (pair.high[a] - pair.low[a]) ** 2
        _eliminate(root, row)


@compiled
def _log_evidence(pair: _Pair, gain: float, prior: Prior) -> float:
    """Laplace's approximation against no contact; leaves the inverse of the root."""
    root, inverse = pair.root, pair.inverse
    evidence = 0.5 * gain + 4.0 * math.log(2.0 * math.pi)
    for i in range(8):
        evidence -= math.log(root[i, i])
        inverse[i, i] = 1.0 / root[i, i]
        for j in range(i):
            total = 0.0
            for k in range(j, i):
                total += root[i, k] * inverse[k, j]
            inverse[i, j] = -total / root[i, i]
    total_m = (prior.reach_m[:, 1] - prior.reach_m[:, 0]).sum()
    for k in range(2):
        y, z = 3 * k + 1, 3 * k + 2
        variance = _shared(inverse, y, y) + _shared(inverse, z, z)
        square = pair.force[y] ** 2 + pair.force[z] ** 2
        disc = 2.0 * math.pi * math.sqrt(square + variance) * prior.largest_n
        evidence -= math.log(disc * math.sqrt(2.0 * math.pi / pair.axial[k]) * total_m)
        evidence -= 0.5 * max(math.sqrt(square) - prior.largest_n, 0.0) ** 2 / variance
    return evidence


@compiled
def _shared(inverse: Array, i: int, j: int) -> float:
    """Covariance of two unknowns, by the inverse of the root."""
    total = 0.0
    for k in range(max(i, j), 8):
        total += inverse[k, i] * inverse[k, j]
    return total


@compiled
def _state(pair: _Pair, n: int, turn: Array, k: int, found: ContactPair, b: int) -> None:
    """Write contact k, on segment n from 0 on, into row b, along the axes at the command."""
    found.segments[b, k] = n + 1
    found.place_m[b, k] = pair.place[k]
    found.place_std_m[b, k] = math.sqrt(_shared(pair.inverse, 6 + k, 6 + k))
    for i in range(3):
        force, variance = 0.0, 0.0
        for p in range(3):
            force += turn[p, i] * pair.force[3 * k + p]
            for q in range(3):
                covariance = _shared(pair.inverse, 3 * k + p, 3 * k + q)
                variance += turn[p, i] * turn[q, i] * covariance
        found.force_n[b, k, i], found.force_std_n[b, k, i] = force, math.sqrt(variance)
