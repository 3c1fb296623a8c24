"""A cable with friction: elastic pieces in a row that stick and slip at the guides between them.

Piece 0 is the one at the actuator, and node k lies between pieces k and k + 1. The tensions on the
two sides of a node are always within the bounds

    exp(-φ) <= T_k / T_(k+1) <= exp(φ),    φ = μ θ,

and cable passes only at that bound (Coulomb's law on a round guide, after Euler and Eytelwein). A
piece between two nodes that stick carries what its own stretch gives and nothing else. How much
cable has passed is the state; it changes from equilibrium to equilibrium, by one implicit step
each.

In the passed lengths this is a complementarity problem with two bounds and an M-matrix, so the
tensions are unique (Cottle, Pang and Stone, The Linear Complementarity Problem, 1992, chapter 3).
If it is known which nodes slip, the lengths that pass them follow from linear equations:

    T_k = s_k (stretch_k + passed_(k-1) - passed_k),    at a node that slips    T_k = r T_(k+1).

A whole cable is taut or slack: a taut piece next to a slack one draws cable out of it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_sim.cable_pull import CablePull
from cablesense_sim.compiled import compiled

_LEAST_PRESLIDING_M = 1e-8
"""Presliding displacement that counts as none."""
_MOST_STEPS = 40
"""Newton steps for one cable: most need fewer than ten."""
_CIRCLES_AFTER = 10
"""Steps after which a cable that alternates between stick and slip is relaxed."""
_SWEEPS = 30
"""Over the nodes of a cable in one relaxation."""
_HALVINGS = 40
"""Bisections of the length that passes a node: to 1e-12 of where they start."""
_ROUNDING = 1e-12
"""Relative rounding of tensions, and lengths (m) below which nothing passes."""


class _Pulled(NamedTuple):
    """The last pull of each cable: an arm at rest is asked for it again and again."""

    lengths_m: Array  # (C, K) where it was; NaN if the state has changed since
    limit: Array  # (C, K - 1)
    tensions_n: Array  # (C, K)
    slope_n_m: Array  # (C, K, K) by these lengths


class _Cables(NamedTuple):
    """C cables of K pieces and K - 1 nodes."""

    stiffness_n_m: Array  # (C, K) of the pieces, zero beyond the end of a cable
    presliding_m: Array  # (C, K - 1) of bristles, zero where a node sticks rigidly
    rounding: Array  # (C, K - 1) Dahl's exponent of bristles
    natural_m: Array  # (C, K) material that lay in the pieces at the last equilibrium, unstretched
    share: Array  # (C, K - 1) of the limit that bristles carried there
    slips: Array  # (C, K - 1) which way a node slipped when last looked at, where a search begins
    passed_m: Array  # (C, K - 1) cable that had passed it then, towards the actuator
    pulled: _Pulled


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


class CableChains:
    """Cables side by side, of up to K pieces; holds how their material lies in the pieces."""

    def __init__(
        self,
        compliance_m_n: Array,
        lengths_m: Array,
        limit: Array,
        share: Array,
        presliding_m: Array | float = 0.0,
        rounding: Array | float = 0.0,
    ) -> None:
        """Cables (...) whose nodes carry a share of their limit, from -1 to 1.

        Args:
            compliance_m_n: (..., K), zero for pieces beyond the end of a cable.
            lengths_m: (..., K) now. They count from any origin for which a cable is just slack
                where they add up to zero.
            limit: (..., K - 1) the limit φ of each node.
            share: (..., K - 1) of it that each carries.
            presliding_m: broadcast to (..., K - 1): cable that passes a node while the share grows
                by one before it slips (bristles); zero sticks rigidly.
            rounding: broadcast likewise, Dahl's exponent from 0 to below 1: bristles stiffen by
                (1 - share)^rounding / presliding on the way to their limit, at 0 evenly.
        """
        self._shape = np.shape(lengths_m)
        nodes = (*self._shape[:-1], self._shape[-1] - 1)
        compliance = np.broadcast_to(compliance_m_n, self._shape)
        exists = compliance > 0.0
        share = np.broadcast_to(share, nodes)
        presliding = np.broadcast_to(presliding_m, nodes)
        passed_on = kept(share, limit)
        parts = compliance * np.concatenate([np.ones_like(passed_on[..., :1]), passed_on], axis=-1)
        whole = lengths_m.sum(-1, keepdims=True)
        parts = np.where(whole > 0.0, parts, compliance)
        natural = lengths_m - parts / parts.sum(-1, keepdims=True) * whole
        self._cables = _Cables(
            stiffness_n_m=_flat(np.where(exists, 1.0 / np.where(exists, compliance, 1.0), 0.0)),
            presliding_m=_flat(np.where(presliding > _LEAST_PRESLIDING_M, presliding, 0.0)),
            rounding=_flat(np.broadcast_to(rounding, nodes).copy()),
            natural_m=_flat(natural),
            share=_flat(share.copy()),
            slips=np.zeros((whole.size, nodes[-1])),
            passed_m=np.zeros((whole.size, nodes[-1])),
            pulled=_Pulled(
                lengths_m=np.full((whole.size, self._shape[-1]), np.nan),
                limit=np.zeros((whole.size, nodes[-1])),
                tensions_n=np.zeros((whole.size, self._shape[-1])),
                slope_n_m=np.zeros((whole.size, self._shape[-1], self._shape[-1])),
            ),
        )

    def pull(self, lengths_m: Array, limit: Array) -> CablePull:
        """At lengths (..., K), m, and limits (..., K - 1) of now, from the state as it is."""
        _pull(self._cables, _flat(lengths_m), _flat(limit))
        pulled = self._cables.pulled
        return CablePull(
            pulled.tensions_n.reshape(self._shape).copy(),
            pulled.slope_n_m.reshape(*self._shape, self._shape[-1]).copy(),
        )

    def settle(self, lengths_m: Array, limit: Array) -> None:
        """Stay there. In a slack cable the material comes to lie evenly."""
        _settle(self._cables, _flat(lengths_m), _flat(limit))


def _flat(values: Array) -> Array:
    """Values (..., K) of cables as (C, K), contiguous."""
    return np.ascontiguousarray(values, dtype=float).reshape(-1, values.shape[-1])


def kept(share: Array, limit: Array) -> Array:
    """Ratio (..., K - 1) of the tension behind each node to that at the actuator.

    Nodes carry a share, from -1 to 1, of their limit φ.
    """
    return np.exp(-np.cumsum(share * limit, axis=-1))


@compiled
def _pull(cables: _Cables, lengths_m: Array, limit: Array) -> None:
    """Pull at lengths (C, K) and limits (C, K - 1), as far as that is not the last pull."""
    count, pieces = lengths_m.shape
    rows = _empty_rows(pieces - 1)
    held = np.empty(pieces)
    right = np.empty((pieces - 1, pieces))
    for c in range(count):
        pulled = cables.pulled
        same = True
        for k in range(pieces):
            same = same and pulled.lengths_m[c, k] == lengths_m[c, k]
        for k in range(pieces - 1):
            same = same and pulled.limit[c, k] == limit[c, k]
        if same:
            continue
        pulled.lengths_m[c] = lengths_m[c]
        pulled.limit[c] = limit[c]
        tensions = pulled.tensions_n[c]
        slope = pulled.slope_n_m[c]
        if not _hold(cables, c, lengths_m[c], held):
            tensions[:] = slope[:] = 0.0
            continue
        _pass(cables, c, held, limit[c], rows)
        stiffness = cables.stiffness_n_m[c]
        _by_stretch(stiffness, rows, right)
        _eliminate(stiffness, rows, right)
        _stretched(stiffness, held, cables.passed_m[c], tensions)
        for k in range(pieces):
            for column in range(pieces):
                slope[k, column] = stiffness[k] * _gained(right[:, column], k)
            slope[k, k] += stiffness[k]


@compiled
def _settle(cables: _Cables, lengths_m: Array, limit: Array) -> None:
    """Stay at lengths (C, K). In a slack cable the material comes to lie evenly."""
    count, pieces = lengths_m.shape
    rows = _empty_rows(pieces - 1)
    held = np.empty(pieces)
    cables.pulled.lengths_m[:] = np.nan
    for c in range(count):
        natural = cables.natural_m[c]
        passed = cables.passed_m[c]
        if _hold(cables, c, lengths_m[c], held):
            _pass(cables, c, held, limit[c], rows)
            for k in range(pieces):
                natural[k] -= _gained(passed, k)
            for k in range(pieces - 1):
                bent = (
                    _bent(cables, c, k, passed[k])[0] if cables.presliding_m[c, k] > 0.0 else 0.0
                )
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
    values = np.empty((5, nodes))
    return _Rows(values[0], values[1], values[2], values[3], values[4])


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
def _bent(cables: _Cables, c: int, k: int, passed: float) -> tuple[float, float]:
    """Share that bristles would carry if they could carry any, and by how much it grows, 1/m.

    The remainder to the limit, u, falls as du/dx = -u^rounding / presliding (Dahl, A solid
    friction model, Aerospace Corp. TOR-0158, 1968); a bristle at rest is taken to be as stiff as
    it is on its way back.
    """
    presliding = cables.presliding_m[c, k]
    share = cables.share[c, k]
    rounding = cables.rounding[c, k]
    if rounding == 0.0:
        return share + passed / presliding, 1.0 / presliding
    if passed == 0.0:
        return share, (1.0 + abs(share)) ** rounding / presliding
    way = np.sign(passed)
    evenly = 1.0 - rounding
    far = max(max(1.0 - way * share, 0.0) ** evenly - evenly * abs(passed) / presliding, -1.0)
    remainder = np.sign(far) * abs(far) ** (1.0 / evenly)
    return way * (1.0 - remainder), max(remainder, 0.0) ** rounding / presliding


@compiled
def _slip_m(cables: _Cables, c: int, k: int, way: float) -> float:
    """Cable that passes a node until its bristles slip a way; none where it sticks rigidly."""
    evenly = 1.0 - cables.rounding[c, k]
    remainder = max(1.0 - way * cables.share[c, k], 0.0)
    return way * cables.presliding_m[c, k] * remainder**evenly / evenly


@compiled
def _pass(cables: _Cables, c: int, held: Array, limit: Array, rows: _Rows) -> None:
    """Finds what passes each node of a taut cable, and the rows that hold, in place.

    Newton's method on the rows: at a node that slips the ratio of tensions is the bound; at
    bristles that hold it is the share that they carry; elsewhere nothing passes. A node sticks
    before it slips the other way. One cable in some thousands alternates; it is relaxed
    before it continues.
    """
    stiffness = cables.stiffness_n_m[c]
    presliding = cables.presliding_m[c]
    passed = cables.passed_m[c]
    tensions = np.empty(len(held))
    last = np.empty(len(passed))
    _stretched(stiffness, held, passed, tensions)
    room = _ROUNDING * np.abs(held).max()
    for step in range(1, _MOST_STEPS + 1):
        if step % _CIRCLES_AFTER == 0:
            _relax(cables, c, held, limit)
            _stretched(stiffness, held, passed, tensions)
            for k in range(len(passed)):
                bent = _bent(cables, c, k, passed[k])[0] if presliding[k] > 0.0 else passed[k]
                slips = abs(bent) >= 1.0 or presliding[k] == 0.0
                cables.slips[c, k] = np.sign(bent) if slips else 0.0
        last[:] = passed
        _set_rows(cables, c, passed, tensions, limit, rows)
        for k in range(len(passed)):
            passed[k] = held[k] - rows.ratio[k] * held[k + 1] + rows.offset_n[k]
        _eliminate(stiffness, rows, passed.reshape(-1, 1))
        still = True
        for k in range(len(passed)):
            # the way back is as stiff as can be, and begins at rest
            if cables.rounding[c, k] > 0.0 and presliding[k] > 0.0 and passed[k] * last[k] < 0.0:
                passed[k] = 0.0
            if presliding[k] > 0.0 and abs(passed[k] - last[k]) > _ROUNDING:
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
    cables: _Cables, c: int, passed: Array, tensions: Array, limit: Array, room: float
) -> bool:
    """Which way each node slips by a guess; whether that has changed."""
    changed = False
    for k in range(len(passed)):
        if cables.stiffness_n_m[c, k + 1] == 0.0:
            continue
        slips = cables.slips[c, k]
        if cables.presliding_m[c, k] > 0.0:
            bent = _bent(cables, c, k, passed[k])[0]
            beyond = bent > 1.0 + _ROUNDING
            below = bent < -1.0 - _ROUNDING
            ahead = bent - slips
        else:
            near = tensions[k]
            far = tensions[k + 1]
            over = np.exp(limit[k])
            beyond = near > far * over + room
            below = near * over < far - room
            ahead = passed[k]
        if slips == 0.0:
            cables.slips[c, k] = 1.0 if beyond else -1.0 if below else 0.0
        elif not slips * ahead >= 0.0:
            cables.slips[c, k] = 0.0
        changed |= cables.slips[c, k] != slips
    return changed


@compiled
def _set_rows(
    cables: _Cables, c: int, passed: Array, tensions: Array, limit: Array, rows: _Rows
) -> None:
    """The rows that hold, linear about a guess where bristles carry."""
    rows.moves[:] = rows.steeper_n_m[:] = rows.offset_n[:] = 0.0
    rows.ratio[:] = 1.0
    for k in range(len(passed)):
        if cables.stiffness_n_m[c, k + 1] == 0.0:
            continue
        if cables.slips[c, k] != 0.0:
            rows.moves[k] = 1.0
            rows.ratio[k] = np.exp(cables.slips[c, k] * limit[k])
        elif cables.presliding_m[c, k] > 0.0:
            bent, stiffer = _bent(cables, c, k, passed[k])
            share = min(max(bent, -1.0), 1.0)
            ratio = np.exp(share * limit[k])
            steeper = stiffer * ratio * limit[k] * max(tensions[k + 1], 0.0)
            bristle_m = _slip_m(cables, c, k, share) if abs(bent) > 1.0 else passed[k]
            rows.moves[k] = 1.0
            rows.ratio[k] = ratio
            rows.steeper_n_m[k] = steeper
            rows.offset_n[k] = steeper * bristle_m


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
    diagonal = rows.diagonal_n_m
    last = len(right) - 1
    columns = range(right.shape[1])
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
def _relax(cables: _Cables, c: int, held: Array, limit: Array) -> None:
    """Passed lengths nearer to the solution, node by node while the others stand, in place.

    This converges from any start, as the matrix is an M-matrix, but slowly.
    """
    stiffness = cables.stiffness_n_m[c]
    passed = cables.passed_m[c]
    for _ in range(_SWEEPS):
        for k in range(len(passed)):
            passed[k] = 0.0
            if stiffness[k + 1] == 0.0:
                continue
            near = held[k] + stiffness[k] * _gained(passed, k)
            far = held[k + 1] + stiffness[k + 1] * _gained(passed, k + 1)
            low = _slip_m(cables, c, k, -1.0)
            high = _slip_m(cables, c, k, 1.0)
            moved = 0.0
            if cables.presliding_m[c, k] > 0.0:
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
def _hold(cables: _Cables, c: int, lengths_m: Array, held: Array) -> bool:
    """Whether the cable is taut; tensions (K,) if nothing passed, in place.

    A slack cable loses its state of friction.
    """
    stretch = lengths_m - cables.natural_m[c]
    held[:] = cables.stiffness_n_m[c] * stretch
    taut = stretch.sum() > 0.0
    if not taut:
        cables.slips[c] = cables.passed_m[c] = 0.0
    return taut
