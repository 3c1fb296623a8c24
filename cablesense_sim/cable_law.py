"""One cable after another with friction, compiled; `cablesense_sim.cable_chain` says the law.

If it is known which nodes slip, the lengths that pass them follow from linear equations:

    T_k = s_k (stretch_k + passed_(k-1) - passed_k),    at a node that slips    T_k = r T_(k+1).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_sim.compiled import compiled

_MOST_STEPS, _CIRCLES_AFTER = 40, 10
_SWEEPS, _HALVINGS = 30, 40
_ROUNDING = 1e-12


class Cables(NamedTuple):
    """C cables of K pieces and K - 1 nodes.

    Attributes:
        stiffness_n_m: (C, K) of the pieces, zero beyond the end of a cable.
        give_m: (C, K - 1) of bristles, zero where a node sticks rigidly.
        rounding: (C, K - 1) Dahl's exponent of bristles.
        natural_m: (C, K) material that lay in the pieces at the last rest, unstretched.
        share: (C, K - 1) of the limit that bristles carried there.
        slips: (C, K - 1) which way a node slipped when last looked at, where a search begins.
        passed_m: (C, K - 1) cable that had passed it then, towards the actuator.
    """

    stiffness_n_m: Array
    give_m: Array
    rounding: Array
    natural_m: Array
    share: Array
    slips: Array
    passed_m: Array


class _Rows(NamedTuple):
    """Equations (K - 1,) of the passed lengths.

    At a node that moves, T_k = ratio T_(k+1); at others nothing passes. Bristles stiffen with the
    cable passed, which makes an equation steeper, N/m, about an offset, N. The diagonal is what
    elimination makes of it, N/m.
    """

    moves: Array
    ratio: Array
    steeper_n_m: Array
    offset_n: Array
    diagonal_n_m: Array


@compiled
def pull(cables: Cables, lengths_m: Array, limit: Array) -> tuple[Array, Array]:
    """Tensions (C, K), N, at lengths (C, K), and their derivative (C, K, K) by these, N/m."""
    count, pieces = lengths_m.shape
    tensions, slope = np.zeros((count, pieces)), np.zeros((count, pieces, pieces))
    rows, held = _empty_rows(pieces - 1), np.empty(pieces)
    right = np.empty((pieces - 1, pieces))
    for c in range(count):
        if not _hold(cables, c, lengths_m[c], held):
            continue
        _pass(cables, c, held, limit[c], rows)
        stiffness = cables.stiffness_n_m[c]
        _by_stretch(stiffness, rows, right)
        _eliminate(stiffness, rows, right)
        _stretched(stiffness, held, cables.passed_m[c], tensions[c])
        for k in range(pieces):
            for column in range(pieces):
                slope[c, k, column] = stiffness[k] * _gained(right[:, column], k)
            slope[c, k, k] += stiffness[k]
    return tensions, slope


@compiled
def settle(cables: Cables, lengths_m: Array, limit: Array) -> None:
    """Stay at lengths (C, K). In a slack cable the material comes to lie evenly."""
    count, pieces = lengths_m.shape
    rows, held = _empty_rows(pieces - 1), np.empty(pieces)
    for c in range(count):
        natural, passed = cables.natural_m[c], cables.passed_m[c]
        if _hold(cables, c, lengths_m[c], held):
            _pass(cables, c, held, limit[c], rows)
            for k in range(pieces):
                natural[k] -= _gained(passed, k)
            for k in range(pieces - 1):
                bent = _bent(cables, c, k, passed[k])[0] if cables.give_m[c, k] > 0.0 else 0.0
                cables.share[c, k] = min(max(bent, -1.0), 1.0)
            passed[:] = 0.0
        else:
            stiffness = cables.stiffness_n_m[c]
            compliance = np.zeros(len(stiffness))
            for k in range(len(stiffness)):
                if stiffness[k] > 0.0:
                    compliance[k] = 1.0 / stiffness[k]
            stretch = (lengths_m[c] - natural).sum()
            natural[:] = lengths_m[c] - compliance / compliance.sum() * stretch
            cables.share[c] = 0.0


@compiled
def _empty_rows(nodes: int) -> _Rows:
    every = np.empty((5, nodes))
    return _Rows(every[0], every[1], every[2], every[3], every[4])


@compiled
def _gained(passed: Array, k: int) -> float:
    """Stretch that piece k gains from the cable that passes its two nodes."""
    before = passed[k - 1] if k > 0 else 0.0
    return before - passed[k] if k < len(passed) else before


@compiled
def _stretched(stiffness: Array, held: Array, passed: Array, tensions: Array) -> None:
    """Write the tensions that pieces have, which were `held` before cable passed."""
    for k in range(len(held)):
        tensions[k] = held[k] + stiffness[k] * _gained(passed, k)


@compiled
def _bent(cables: Cables, c: int, k: int, passed: float) -> tuple[float, float]:
    """Share that bristles would carry if they could carry any, and by how much it grows, 1/m.

    The remainder to the limit, u, falls as du/dx = -u^rounding / give (Dahl, A solid friction
    model, Aerospace Corp. TOR-0158, 1968); a bristle at rest is taken to be as stiff as it is on
    its way back.
    """
    give, share, rounding = cables.give_m[c, k], cables.share[c, k], cables.rounding[c, k]
    if rounding == 0.0:
        return share + passed / give, 1.0 / give
    if passed == 0.0:
        return share, (1.0 + abs(share)) ** rounding / give
    way, evenly = np.sign(passed), 1.0 - rounding
    far = max(max(1.0 - way * share, 0.0) ** evenly - evenly * abs(passed) / give, -1.0)
    left = np.sign(far) * abs(far) ** (1.0 / evenly)
    return way * (1.0 - left), max(left, 0.0) ** rounding / give


@compiled
def _slip_m(cables: Cables, c: int, k: int, way: float) -> float:
    """Cable that passes a node until its bristles slip a way; none where it sticks rigidly."""
    evenly = 1.0 - cables.rounding[c, k]
    left = max(1.0 - way * cables.share[c, k], 0.0)
    return way * cables.give_m[c, k] * left**evenly / evenly


@compiled
def _pass(cables: Cables, c: int, held: Array, limit: Array, rows: _Rows) -> None:
    """Finds what passes each node of a taut cable, and the rows that hold, in place.

    Newton's method on the rows: at a node that slips the ratio of tensions is the bound; at
    bristles that hold it is the share that they carry; elsewhere nothing passes. A node sticks
    before it slips the other way. One cable in some thousands alternates; it is relaxed
    before it goes on.
    """
    stiffness, give, passed = cables.stiffness_n_m[c], cables.give_m[c], cables.passed_m[c]
    tensions, last = np.empty(len(held)), np.empty(len(passed))
    _stretched(stiffness, held, passed, tensions)
    room = _ROUNDING * np.abs(held).max()
    for step in range(1, _MOST_STEPS + 1):
        if step % _CIRCLES_AFTER == 0:
            _relax(cables, c, held, limit)
            _stretched(stiffness, held, passed, tensions)
            for k in range(len(passed)):
                bent = _bent(cables, c, k, passed[k])[0] if give[k] > 0.0 else passed[k]
                slips = abs(bent) >= 1.0 or give[k] == 0.0
                cables.slips[c, k] = np.sign(bent) if slips else 0.0
        last[:] = passed
        _set_rows(cables, c, passed, tensions, limit, rows)
        for k in range(len(passed)):
            passed[k] = held[k] - rows.ratio[k] * held[k + 1] + rows.offset_n[k]
        _eliminate(stiffness, rows, passed.reshape(-1, 1))
        still = True
        for k in range(len(passed)):
            # the way back is as stiff as can be, and begins at rest
            if cables.rounding[c, k] > 0.0 and give[k] > 0.0 and passed[k] * last[k] < 0.0:
                passed[k] = 0.0
            if give[k] > 0.0 and abs(passed[k] - last[k]) > _ROUNDING:
                still = False
        _stretched(stiffness, held, passed, tensions)
        if not _slip(cables, c, passed, tensions, limit, room) and still:
            return
    for _ in range(_MOST_STEPS):
        last[:] = passed
        _relax(cables, c, held, limit)
        if np.abs(passed - last).max() <= _ROUNDING:
            break
    _stretched(stiffness, held, passed, tensions)
    _set_rows(cables, c, passed, tensions, limit, rows)


@compiled
def _slip(
    cables: Cables, c: int, passed: Array, tensions: Array, limit: Array, room: float
) -> bool:
    """Which way each node slips by a guess; whether that has changed."""
    changed = False
    for k in range(len(passed)):
        if cables.stiffness_n_m[c, k + 1] == 0.0:
            continue
        slips = cables.slips[c, k]
        if cables.give_m[c, k] > 0.0:
            bent = _bent(cables, c, k, passed[k])[0]
            beyond, below, ahead = bent > 1.0 + _ROUNDING, bent < -1.0 - _ROUNDING, bent - slips
        else:
            near, far, over = tensions[k], tensions[k + 1], np.exp(limit[k])
            beyond, below, ahead = near > far * over + room, near * over < far - room, passed[k]
        if slips == 0.0:
            cables.slips[c, k] = 1.0 if beyond else -1.0 if below else 0.0
        elif not slips * ahead >= 0.0:
            cables.slips[c, k] = 0.0
        changed |= cables.slips[c, k] != slips
    return changed


@compiled
def _set_rows(
    cables: Cables, c: int, passed: Array, tensions: Array, limit: Array, rows: _Rows
) -> None:
    """The rows that hold, linear about a guess where bristles carry."""
    rows.moves[:] = rows.steeper_n_m[:] = rows.offset_n[:] = 0.0
    rows.ratio[:] = 1.0
    for k in range(len(passed)):
        if cables.stiffness_n_m[c, k + 1] == 0.0:
            continue
        if cables.slips[c, k] != 0.0:
            rows.moves[k], rows.ratio[k] = 1.0, np.exp(cables.slips[c, k] * limit[k])
        elif cables.give_m[c, k] > 0.0:
            bent, stiffer = _bent(cables, c, k, passed[k])
            share = min(max(bent, -1.0), 1.0)
            ratio = np.exp(share * limit[k])
            steeper = stiffer * ratio * limit[k] * max(tensions[k + 1], 0.0)
            at = _slip_m(cables, c, k, share) if abs(bent) > 1.0 else passed[k]
            rows.moves[k], rows.ratio[k] = 1.0, ratio
            rows.steeper_n_m[k], rows.offset_n[k] = steeper, steeper * at


@compiled
def _by_stretch(stiffness: Array, rows: _Rows, right: Array) -> None:
    """Right-hand sides for the derivative by the pieces' stretch, in the first K columns."""
    right[:] = 0.0
    for k in range(len(right)):
        right[k, k] = stiffness[k]
        right[k, k + 1] = -rows.ratio[k] * stiffness[k + 1]


@compiled
def _eliminate(stiffness: Array, rows: _Rows, right: Array) -> None:
    """Thomas's algorithm for several right-hand sides (K - 1, any), in place."""
    diagonal, last, columns = rows.diagonal_n_m, len(right) - 1, range(right.shape[1])
    for k in range(last + 1):
        if rows.moves[k] == 0.0:
            diagonal[k] = 1.0
            right[k] = 0.0
            continue
        diagonal[k] = stiffness[k] + rows.ratio[k] * stiffness[k + 1] + rows.steeper_n_m[k]
        if k > 0 and rows.moves[k - 1] > 0.0:
            part = stiffness[k] / diagonal[k - 1]
            diagonal[k] -= part * rows.ratio[k - 1] * stiffness[k]
            for column in columns:
                right[k, column] += part * right[k - 1, column]
    for k in range(last, -1, -1):
        if rows.moves[k] == 0.0:
            continue
        far = rows.ratio[k] * stiffness[k + 1]
        for column in columns:
            if k < last:
                right[k, column] += far * right[k + 1, column]
            right[k, column] /= diagonal[k]


@compiled
def _relax(cables: Cables, c: int, held: Array, limit: Array) -> None:
    """Passed lengths nearer to the solution, node by node while the others stand, in place.

    This converges from any start, as the matrix is an M-matrix, but slowly.
    """
    stiffness, passed = cables.stiffness_n_m[c], cables.passed_m[c]
    for _ in range(_SWEEPS):
        for k in range(len(passed)):
            passed[k] = 0.0
            if stiffness[k + 1] == 0.0:
                continue
            near = held[k] + stiffness[k] * _gained(passed, k)
            far = held[k + 1] + stiffness[k + 1] * _gained(passed, k + 1)
            low, high = _slip_m(cables, c, k, -1.0), _slip_m(cables, c, k, 1.0)
            moved = 0.0
            if cables.give_m[c, k] > 0.0:
                for _ in range(_HALVINGS):  # what passes if the node does not slip
                    moved = 0.5 * (low + high)
                    share = min(max(_bent(cables, c, k, moved)[0], -1.0), 1.0)
                    ratio = np.exp(share * limit[k])
                    if near - stiffness[k] * moved > ratio * (far + stiffness[k + 1] * moved):
                        low = moved
                    else:
                        high = moved
            for way in (1.0, -1.0):
                ratio = np.exp(way * limit[k])
                most = (near - ratio * far) / (stiffness[k] + ratio * stiffness[k + 1])
                if way * (most - _slip_m(cables, c, k, way)) > 0.0:
                    moved = most
            passed[k] = moved


@compiled
def _hold(cables: Cables, c: int, lengths_m: Array, held: Array) -> bool:
    """Whether the cable is taut; tensions (K,) if nothing passed, in place.

    A slack cable loses its state of friction.
    """
    stretch = lengths_m - cables.natural_m[c]
    held[:] = cables.stiffness_n_m[c] * stretch
    whole = 0.0
    for each in stretch:
        whole += each
    if not whole > 0.0:
        cables.slips[c] = 0.0
        cables.passed_m[c] = 0.0
    return whole > 0.0
