"""A cable with friction: elastic pieces in a row that stick and slip at the guides between them.

Piece 0 is the run at the actuator, and node k lies between pieces k and k + 1. The tensions on the
two sides of a node are never further apart than

    exp(-φ) <= T_k / T_(k+1) <= exp(φ),    φ = μ θ,

and cable passes only at that bound (Coulomb's law on a round guide, after Euler and Eytelwein). A
piece between two nodes that stick carries what its own stretch gives and nothing else. How much
cable has passed is the state; it changes from rest to rest, by one implicit step each.

In the passed lengths this is a complementarity problem with two bounds and an M-matrix, so the
tensions are unique (Cottle, Pang and Stone, The Linear Complementarity Problem, 1992, chapter 3).
A whole cable is taut or slack: a taut piece next to a slack one draws cable out of it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array

_MOST_STEPS = 40
_CIRCLES_AFTER = 10
_SWEEPS = 30
_SHARE_STEPS = 4
_ROUNDING = 1e-12


class Pull(NamedTuple):
    """Tensions of cables of K pieces.

    Attributes:
        tensions_n: (..., K) of each piece, the actuator's first; zero in a slack cable.
        by_length_n_m: (..., K, K) derivative by the pieces' lengths.
    """

    tensions_n: Array
    by_length_n_m: Array


class CableChains:
    """Cables side by side, of up to K pieces; holds how their material lies in the pieces."""

    def __init__(
        self, compliance_m_n: Array, lengths_m: Array, limit: Array, share: Array,
        give_m: Array | float = 0.0,
    ) -> None:  # fmt: skip
        """Cables (...) whose nodes carry a share of their limit, from -1 to 1.

        Args:
            compliance_m_n: (..., K), zero for pieces beyond the end of a cable.
            lengths_m: (..., K) now. They count from any origin for which a cable is just slack
                where they add up to zero.
            limit: (..., K - 1) the limit φ of each node.
            share: (..., K - 1) of it that each carries.
            give_m: broadcast to (..., K - 1): cable that passes a node while the share grows by
                one before it slips (bristles); zero sticks rigidly.
        """
        exists = compliance_m_n > 0.0
        self._stiffness_n_m = np.where(exists, 1.0 / np.where(exists, compliance_m_n, 1.0), 0.0)
        self._evenly = compliance_m_n / compliance_m_n.sum(-1, keepdims=True)
        self._joined = exists[..., 1:]
        self._give_m = np.broadcast_to(give_m, self._joined.shape)
        self._share = np.broadcast_to(share, self._joined.shape)
        self._rigid = self._give_m <= 0.0
        self._all_rigid = bool(self._rigid.all())
        self._slips = np.zeros(self._joined.shape)
        kept = np.exp(-np.cumsum(share * limit, axis=-1))
        parts = compliance_m_n * np.concatenate([np.ones_like(kept[..., :1]), kept], axis=-1)
        whole = lengths_m.sum(-1, keepdims=True)
        parts = np.where(whole > 0.0, parts / parts.sum(-1, keepdims=True), self._evenly)
        self._natural_m = lengths_m - parts * whole

    def pull(self, lengths_m: Array, limit: Array) -> Pull:
        """At lengths (..., K), m, and limits (..., K - 1) of now, from the state as it is."""
        stretch, taut = self._stretch(lengths_m)
        passed, rows = self._passed(stretch, limit, taut)
        by_length = np.eye(stretch.shape[-1]) + _gained(rows.by_stretch(), -2)
        slope = self._stiffness_n_m[..., None] * by_length
        return Pull(
            np.where(taut, self._stiffness_n_m * (stretch + _gained(passed, -1)), 0.0),
            np.where(taut[..., None], slope, 0.0),
        )

    def settle(self, lengths_m: Array, limit: Array) -> None:
        """Stay there. In a slack cable the material comes to lie evenly."""
        stretch, taut = self._stretch(lengths_m)
        passed, _ = self._passed(stretch, limit, taut)
        slack = self._evenly * stretch.sum(-1, keepdims=True)
        self._natural_m = lengths_m - np.where(taut, stretch + _gained(passed, -1), slack)
        self._share = np.where(taut, np.clip(self._bent(passed), -1.0, 1.0), 0.0)

    def _stretch(self, lengths_m: Array) -> tuple[Array, NDArray[np.bool_]]:
        """(..., K) of the pieces if nothing passed, and (..., 1) whether the cable is taut."""
        stretch = lengths_m - self._natural_m
        return stretch, stretch.sum(-1, keepdims=True) > 0.0

    def _bent(self, passed: Array) -> Array:
        """Share that bristles would carry if they could carry any; of rigid nodes any."""
        return np.asarray(self._share + passed / np.where(self._give_m > 0.0, self._give_m, 1.0))

    def _passed(
        self, stretch: Array, limit: Array, taut: NDArray[np.bool_]
    ) -> tuple[Array, _Rows]:
        """Cable (..., K - 1) that passes each node towards the actuator, and the rows that hold.

        Newton's method on the rows that hold: where a node slips the tensions are apart by the
        bound, where bristles hold by the share that they carry, and else nothing passes. A node
        sticks before it slips the other way. One cable in some thousands goes in circles; it is
        relaxed before it goes on.
        """
        free, rigid, over = self._joined & taut, self._rigid, np.exp(limit)
        held = np.where(taut, self._stiffness_n_m * stretch, 0.0)
        slips = np.where(free, self._slips, 0.0)
        passed, tensions = np.zeros(free.shape), held
        room = _ROUNDING * np.abs(held).max(-1, keepdims=True)
        for step in range(1, _MOST_STEPS + 1):
            if step % _CIRCLES_AFTER == 0:
                passed = self._relaxed(passed, held, limit, free)
                tensions = held + self._stiffness_n_m * _gained(passed, -1)
                bent = self._bent(passed)
                slips = np.where(rigid, np.sign(passed), np.sign(bent) * (np.abs(bent) >= 1.0))
            last, before = passed, slips
            rows = self._rows(free, slips, passed, tensions, limit)
            passed = rows.solved(held)
            tensions = held + self._stiffness_n_m * _gained(passed, -1)
            near, far = tensions[..., :-1], tensions[..., 1:]
            beyond, below, ahead = near > far * over + room, near * over < far - room, passed
            if not self._all_rigid:
                bent = self._bent(passed)
                beyond = np.where(rigid, beyond, bent > 1.0 + _ROUNDING)
                below = np.where(rigid, below, bent < -1.0 - _ROUNDING)
                ahead = np.where(rigid, passed, bent - slips)
            starts = (beyond & free).astype(float) - (below & free)
            slips = np.where(slips == 0.0, starts, np.where(slips * ahead < 0.0, 0.0, slips))
            if np.array_equal(slips, before) and (
                self._all_rigid or not (np.abs(passed - last) > _ROUNDING)[free & ~rigid].any()
            ):
                break
        self._slips = slips
        return passed, rows

    def _rows(
        self, free: NDArray[np.bool_], slips: Array, passed: Array, tensions: Array, limit: Array
    ) -> _Rows:
        """The rows that hold, linear about a guess where bristles carry."""
        if self._all_rigid:
            none = np.zeros(1)
            return _Rows(slips != 0.0, self._stiffness_n_m, np.exp(slips * limit), none, none)
        bends = free & (slips == 0.0) & ~self._rigid
        share = np.where(bends, np.clip(self._bent(passed), -1.0, 1.0), slips)
        ratio = np.exp(share * limit)
        give = np.where(bends, self._give_m, np.inf)
        steeper = ratio * limit * np.maximum(tensions[..., 1:], 0.0) / give
        at = np.where(bends, (share - self._share) * self._give_m, 0.0)
        return _Rows(bends | (slips != 0.0), self._stiffness_n_m, ratio, steeper, steeper * at)

    def _relaxed(self, passed: Array, held: Array, limit: Array, free: NDArray[np.bool_]) -> Array:
        """Passed lengths nearer to the solution, node by node while the others stand.

        That converges from anywhere, as the matrix is an M-matrix, but slowly.
        """
        passed = passed.copy()
        stiffness = np.broadcast_to(self._stiffness_n_m, held.shape)
        for k in [*range(free.shape[-1])] * _SWEEPS:
            passed[..., k] = np.where(free[..., k], 0.0, passed[..., k])
            tensions = held + stiffness * _gained(passed, -1)
            near, far = tensions[..., k], tensions[..., k + 1]
            k_near, k_far = stiffness[..., k], stiffness[..., k + 1]
            phi, carried, give = limit[..., k], self._share[..., k], self._give_m[..., k]
            share = carried  # that the node ends with, found by Newton's method
            for _ in range(_SHARE_STEPS):
                ratio = np.exp(share * phi)
                per_m, moved = k_near + ratio * k_far, (share - carried) * give
                steeper = ratio * phi * np.maximum(far + k_far * moved, 0.0) + per_m * give
                missing = near - ratio * far - per_m * moved
                share = share + missing / np.where(steeper > 0.0, steeper, np.inf)
                share = np.clip(share, -1.0, 1.0)
            moved = np.where(give > 0.0, (share - carried) * give, 0.0)
            for way in (1.0, -1.0):
                ratio = np.exp(way * phi)
                most = (near - ratio * far) / np.where(free[..., k], k_near + ratio * k_far, 1.0)
                slips = way * (most - np.where(give > 0.0, (way - carried) * give, 0.0)) > 0.0
                moved = np.where(slips, most, moved)
            passed[..., k] = np.where(free[..., k], moved, 0.0)
        return passed


class _Rows(NamedTuple):
    """Equations of the passed lengths: T_k = ratio T_(k+1) where a node moves, else zero.

    The shapes are those of the nodes (..., K - 1), and (..., K) of the pieces' stiffness, N/m.
    Bristles make a row steeper, N/m, by what they stiffen with the cable passed, about an
    `offset`, N.
    """

    moves: NDArray[np.bool_]
    stiffness: Array
    ratio: Array
    steeper: Array
    offset: Array

    def solved(self, held: Array) -> Array:
        """Lengths (..., K - 1), from the tensions (..., K) if nothing passed."""
        right = held[..., :-1] - self.ratio * held[..., 1:] + self.offset
        return self._eliminated(right[..., None])[..., 0]

    def by_stretch(self) -> Array:
        """Their derivative (..., K - 1, K) by the pieces' stretch."""
        nodes = np.arange(self.moves.shape[-1])
        right = np.zeros((*self.moves.shape, len(nodes) + 1))
        right[..., nodes, nodes] = self.stiffness[..., :-1]
        right[..., nodes, nodes + 1] = -self.ratio * self.stiffness[..., 1:]
        return self._eliminated(right)

    def _eliminated(self, right: Array) -> Array:
        """Thomas's algorithm for several right-hand sides (..., K - 1, any)."""
        near, far = self.stiffness[..., :-1], self.ratio * self.stiffness[..., 1:]
        right = right * self.moves[..., None]
        diagonal = np.where(self.moves, near + far + self.steeper, 1.0)
        below, above = np.where(self.moves, -near, 0.0), np.where(self.moves, -far, 0.0)
        last = self.moves.shape[-1] - 1
        for k in range(1, last + 1):
            part = below[..., k] / diagonal[..., k - 1]
            diagonal[..., k] -= part * above[..., k - 1]
            right[..., k, :] -= part[..., None] * right[..., k - 1, :]
        right[..., last, :] /= diagonal[..., last, None]
        for k in range(last - 1, -1, -1):
            right[..., k, :] -= above[..., k, None] * right[..., k + 1, :]
            right[..., k, :] /= diagonal[..., k, None]
        return np.asarray(right)


def _gained(passed: Array, axis: int) -> Array:
    """What the pieces' stretch gains by what passes the nodes, along an axis of K - 1."""
    none = np.zeros_like(np.take(passed, [0], axis))
    return np.asarray(np.concatenate([none, passed], axis) - np.concatenate([passed, none], axis))
