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

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array

_MOST_STEPS = 40
_CIRCLES_AFTER = 10
_SWEEPS = 30
_HALVINGS = 40
_ROUNDING = 1e-12
_TURNS = 12
_CLOSE_RAD = 1e-6
_LEAST_GIVE_M = 1e-8


class Pull(NamedTuple):
    """Tensions of cables of K pieces.

    Attributes:
        tensions_n: (..., K) of each piece, the actuator's first; zero in a slack cable.
        by_length_n_m: (..., K, K) derivative by the pieces' lengths.
    """

    tensions_n: Array
    by_length_n_m: Array


class CableChains:
    """Cables side by side, of up to K pieces; holds how their material lies in the pieces.

    Inside, the axis of the pieces or nodes is the first, so that each is in one stretch of memory.
    """

    def __init__(
        self, compliance_m_n: Array, lengths_m: Array, limit: Array, share: Array,
        give_m: Array | float = 0.0, rounding: Array | float = 0.0,
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
            rounding: broadcast likewise, Dahl's exponent from 0 to below 1: bristles stiffen by
                (1 - share)^rounding / give on the way to their limit, at 0 evenly.
        """
        compliance, lengths, limit = _first(compliance_m_n), _first(lengths_m), _first(limit)
        exists = compliance > 0.0
        self._stiffness_n_m = np.where(exists, 1.0 / np.where(exists, compliance, 1.0), 0.0)
        self._evenly = compliance / compliance.sum(0)
        self._joined = exists[1:] & np.ones(lengths.shape[1:], dtype=bool)
        nodes = self._joined.shape[1:] + self._joined.shape[:1]
        give = _first(np.broadcast_to(give_m, nodes))
        self._give_m = np.where(give > _LEAST_GIVE_M, give, 0.0)
        self._rounding = _first(np.broadcast_to(rounding, nodes))
        self._sharp = not self._rounding.any()
        self._share = _first(np.broadcast_to(share, nodes))
        self._rigid = self._give_m <= 0.0
        self._all_rigid = bool(self._rigid.all())
        self._slips = np.zeros(self._joined.shape)
        kept = np.exp(-np.cumsum(self._share * limit, axis=0))
        parts = compliance * np.concatenate([np.ones_like(kept[:1]), kept])
        whole = lengths.sum(0)
        parts = np.where(whole > 0.0, parts / parts.sum(0), self._evenly)
        self._natural_m = lengths - parts * whole

    def pull(self, lengths_m: Array, limit: Array) -> Pull:
        """At lengths (..., K), m, and limits (..., K - 1) of now, from the state as it is."""
        stretch, taut = self._stretch(_first(lengths_m))
        passed, rows = self._passed(stretch, _first(limit), taut)
        slope = _gained(rows.by_stretch())
        pieces = np.arange(len(slope))
        slope[pieces, pieces] += 1.0
        slope *= (self._stiffness_n_m * taut)[:, None]
        return Pull(
            np.moveaxis(
                np.where(taut, self._stiffness_n_m * (stretch + _gained(passed)), 0.0), 0, -1
            ),
            np.moveaxis(slope, (0, 1), (-2, -1)),
        )

    def settle(self, lengths_m: Array, limit: Array) -> None:
        """Stay there. In a slack cable the material comes to lie evenly."""
        lengths = _first(lengths_m)
        stretch, taut = self._stretch(lengths)
        passed, _ = self._passed(stretch, _first(limit), taut)
        slack = self._evenly * stretch.sum(0)
        self._natural_m = lengths - np.where(taut, stretch + _gained(passed), slack)
        self._share = np.where(taut, np.clip(self._bent(passed)[0], -1.0, 1.0), 0.0)

    def balancing_turn_rad(
        self, lengths_m: Array, limit: Array, by_turn_m: Array, torque_n_m: Array, slope_n_m: Array
    ) -> Array | None:
        """The turn (P, 2N) of P arms' joints after which the torques on them are balanced.

        All is linear in it but which nodes slip and which cables are slack, and these are sought
        along with the turn, so that no search goes on within another. None where no node sticks
        rigidly: there is nothing to seek then.

        Args:
            lengths_m: (P, M, 1 + N) of the cables' pieces now.
            limit: (P, M, N) of the nodes.
            by_turn_m: (P, M, N, 2) derivative of the pieces but the first, each by the two angles
                of its own joint.
            torque_n_m: (P, 2N) of all but the cables.
            slope_n_m: (P, 2N, 2N) its derivative, with what cables add that keep their tensions.
        """
        if not self._rigid.any():
            return None
        limit, by_own = _first(limit), np.moveaxis(by_turn_m, (-2, -1), (0, 1)).copy()
        count, angles = len(by_own), 2 * len(by_own)
        start, _ = self._stretch(_first(lengths_m))
        stiffness = np.broadcast_to(self._stiffness_n_m, start.shape)
        joints = np.arange(count)
        slips, stretch, turn = self._slips, start.copy(), np.zeros_like(torque_n_m)
        passed, tensions = np.zeros(self._joined.shape), stiffness * start
        room = _ROUNDING * np.abs(tensions).max(0)
        for _ in range(_TURNS):
            taut = stretch.sum(0) > 0.0
            free = self._joined & taut
            slips = before = np.where(free, slips, 0.0)
            rows = self._rows(free, slips, passed, tensions, limit)
            held = stiffness * stretch * taut
            passed, by_stretch = rows.solved_with_derivative(held)
            tensions = held + stiffness * _gained(passed)
            # by the angles of every joint, (K, N, 2, P, M)
            passed_by_turn = by_stretch[:, 1:, None] * by_own
            by_turn = _gained(passed_by_turn)
            by_turn[joints + 1, joints] += by_own
            by_turn *= (stiffness * taut)[:, None, None]
            pulling = (by_own * tensions[1:, None]).sum(-1).reshape(angles, -1).T
            whole = (by_own[:, :, None, None] * by_turn[1:, None]).sum(-1)
            whole = np.moveaxis(whole.reshape(angles, angles, -1), -1, 0) + slope_n_m
            missing = torque_n_m + (slope_n_m @ turn[..., None])[..., 0] + pulling
            step = -np.linalg.solve(whole, missing[..., None])[..., 0]
            turn = turn + step
            own = step.T.reshape(count, 2, -1, 1)
            stretch[1:] = start[1:] + (by_own * turn.T.reshape(own.shape)).sum(1)
            passed = passed + (passed_by_turn * own).sum((1, 2))
            tensions = tensions + (by_turn * own).sum((1, 2))
            slips = self._slipping(free, slips, passed, tensions, limit, room)
            close = self._all_rigid or np.abs(step).max() < _CLOSE_RAD
            if close and np.array_equal(slips, before):
                break
        self._slips = slips
        return turn

    def _stretch(self, lengths: Array) -> tuple[Array, NDArray[np.bool_]]:
        """(K, ...) of the pieces if nothing passed, and (...) whether the cable is taut."""
        stretch = lengths - self._natural_m
        return stretch, stretch.sum(0) > 0.0

    def _bent(self, passed: Array, node: Any = ...) -> tuple[Array, Array]:
        """Share that bristles would carry if they could carry any, and by how much it grows, 1/m.

        Of all nodes or of one; of rigid ones any. What is left to the limit, u, falls as
        du/dx = -u^rounding / give (Dahl, A solid friction model, Aerospace Corp. TOR-0158, 1968);
        a bristle at rest is taken to be as stiff as it is on its way back.
        """
        give, share = self._give_m[node], self._share[node]
        give = np.where(give > 0.0, give, 1.0)
        if self._sharp:
            return share + passed / give, 1.0 / give
        way, evenly = np.sign(passed), 1.0 - self._rounding[node]
        left = np.maximum(1.0 - way * share, 0.0)
        far = np.maximum(left**evenly - evenly * np.abs(passed) / give, -1.0)
        left = np.sign(far) * np.abs(far) ** (1.0 / evenly)
        bent = np.where(way == 0.0, share, way * (1.0 - left))
        stiff = np.where(way == 0.0, 1.0 + np.abs(share), np.maximum(left, 0.0))
        return bent, stiff ** self._rounding[node] / give

    def _slip_m(self, way: Array | float, node: Any = ...) -> Array:
        """Cable that passes bristles, or those of a node, until they slip a way."""
        evenly = 1.0 - self._rounding[node]
        left = np.maximum(1.0 - way * self._share[node], 0.0)
        return np.asarray(way * self._give_m[node] * left**evenly / evenly)

    def _passed(
        self, stretch: Array, limit: Array, taut: NDArray[np.bool_]
    ) -> tuple[Array, _Rows]:
        """Cable (K - 1, ...) that passes each node towards the actuator, and the rows that hold.

        Newton's method on the rows that hold: where a node slips the tensions are apart by the
        bound, where bristles hold by the share that they carry, and else nothing passes. A node
        sticks before it slips the other way. One cable in some thousands goes in circles; it is
        relaxed before it goes on.
        """
        free, rigid = self._joined & taut, self._rigid
        held = np.where(taut, self._stiffness_n_m * stretch, 0.0)
        slips = np.where(free, self._slips, 0.0)
        passed, tensions = np.zeros(free.shape), held
        room = _ROUNDING * np.abs(held).max(0)
        for step in range(1, _MOST_STEPS + 1):
            if step % _CIRCLES_AFTER == 0:
                passed = self._relaxed(passed, held, limit, free)
                tensions = held + self._stiffness_n_m * _gained(passed)
                bent, _ = self._bent(passed)
                slips = np.where(rigid, np.sign(passed), np.sign(bent) * (np.abs(bent) >= 1.0))
                slips = np.where(free, slips, 0.0)
            last, before = passed, slips
            rows = self._rows(free, slips, passed, tensions, limit)
            passed = rows.solved(held)
            if not self._sharp:  # the way back is as stiff as can be, and begins at rest
                passed = np.where(~rigid & (passed * last < 0.0), 0.0, passed)
            tensions = held + self._stiffness_n_m * _gained(passed)
            slips = self._slipping(free, slips, passed, tensions, limit, room)
            if np.array_equal(slips, before) and (
                self._all_rigid or not (np.abs(passed - last) > _ROUNDING)[free & ~rigid].any()
            ):
                break
        else:
            for _ in range(_MOST_STEPS):
                last, passed = passed, self._relaxed(passed, held, limit, free)
                if not (np.abs(passed - last) > _ROUNDING).any():
                    break
            tensions = held + self._stiffness_n_m * _gained(passed)
            rows = self._rows(free, slips, passed, tensions, limit)
        self._slips = slips
        return passed, rows

    def _slipping(
        self,
        free: NDArray[np.bool_],
        slips: Array,
        passed: Array,
        tensions: Array,
        limit: Array,
        room: Array,
    ) -> Array:
        """Which way (K - 1, ...) each node slips by a guess; one sticks before it slips back."""
        near, far, over = tensions[:-1], tensions[1:], np.exp(limit)
        beyond, below, ahead = near > far * over + room, near * over < far - room, passed
        if not self._all_rigid:
            bent, _ = self._bent(passed)
            beyond = np.where(self._rigid, beyond, bent > 1.0 + _ROUNDING)
            below = np.where(self._rigid, below, bent < -1.0 - _ROUNDING)
            ahead = np.where(self._rigid, passed, bent - slips)
        starts = (beyond & free).astype(float) - (below & free)
        return np.where(slips == 0.0, starts, slips * (slips * ahead >= 0.0))

    def _rows(
        self, free: NDArray[np.bool_], slips: Array, passed: Array, tensions: Array, limit: Array
    ) -> _Rows:
        """The rows that hold, linear about a guess where bristles carry."""
        if self._all_rigid:
            return _Rows(slips != 0.0, self._stiffness_n_m, np.exp(slips * limit))
        bends = free & (slips == 0.0) & ~self._rigid
        bent, stiffer = self._bent(passed)
        share = np.where(bends, np.clip(bent, -1.0, 1.0), slips)
        ratio = np.exp(share * limit)
        steeper = bends * stiffer * ratio * limit * np.maximum(tensions[1:], 0.0)
        at = np.where(np.abs(bent) > 1.0, self._slip_m(share), passed)
        return _Rows(bends | (slips != 0.0), self._stiffness_n_m, ratio, steeper, steeper * at)

    def _relaxed(self, passed: Array, held: Array, limit: Array, free: NDArray[np.bool_]) -> Array:
        """Passed lengths nearer to the solution, node by node while the others stand.

        That converges from anywhere, as the matrix is an M-matrix, but slowly.
        """
        passed = passed.copy()
        stiffness = np.broadcast_to(self._stiffness_n_m, held.shape)
        for k in [*range(len(free))] * _SWEEPS:
            passed[k] = np.where(free[k], 0.0, passed[k])
            tensions = held + stiffness * _gained(passed)
            near, far = tensions[k], tensions[k + 1]
            k_near, k_far = stiffness[k], stiffness[k + 1]
            phi, low, high = limit[k], self._slip_m(-1.0, k), self._slip_m(1.0, k)
            for _ in range(_HALVINGS):  # what passes if the node does not slip
                moved = 0.5 * (low + high)
                share = np.clip(self._bent(moved, k)[0], -1.0, 1.0)
                more = near - k_near * moved > np.exp(share * phi) * (far + k_far * moved)
                low, high = np.where(more, moved, low), np.where(more, high, moved)
            for way in (1.0, -1.0):
                ratio = np.exp(way * phi)
                most = (near - ratio * far) / np.where(free[k], k_near + ratio * k_far, 1.0)
                moved = np.where(way * (most - self._slip_m(way, k)) > 0.0, most, moved)
            passed[k] = np.where(free[k], moved, 0.0)
        return passed


class _Rows(NamedTuple):
    """Equations of the passed lengths: T_k = ratio T_(k+1) where a node moves, else zero.

    The shapes are those of the nodes (K - 1, ...), and (K, ...) of the pieces' stiffness, N/m.
    Bristles make a row steeper, N/m, by what they stiffen with the cable passed, about an
    `offset`, N.
    """

    moves: NDArray[np.bool_]
    stiffness: Array
    ratio: Array
    steeper: Array | float = 0.0
    offset: Array | float = 0.0

    def solved(self, held: Array) -> Array:
        """Lengths (K - 1, ...), from the tensions (K, ...) if nothing passed."""
        return self._eliminated((held[:-1] - self.ratio * held[1:] + self.offset)[:, None])[:, 0]

    def by_stretch(self) -> Array:
        """Their derivative (K - 1, K, ...) by the pieces' stretch."""
        return self._eliminated(self._by_stretch(0))

    def solved_with_derivative(self, held: Array) -> tuple[Array, Array]:
        """Both at once."""
        right = self._by_stretch(1)
        right[:, -1] = held[:-1] - self.ratio * held[1:] + self.offset
        found = self._eliminated(right)
        return found[:, -1], found[:, :-1]

    def _by_stretch(self, more: int) -> Array:
        count = len(self.moves)
        right = np.zeros((count, count + 1 + more, *self.moves.shape[1:]))
        nodes = np.arange(count)
        right[nodes, nodes] = self.stiffness[:-1]
        right[nodes, nodes + 1] = -self.ratio * self.stiffness[1:]
        return right

    def _eliminated(self, right: Array) -> Array:
        """Thomas's algorithm for several right-hand sides (K - 1, any, ...), in place."""
        moves = self.moves.astype(float)
        near, far = moves * self.stiffness[:-1], moves * self.ratio * self.stiffness[1:]
        diagonal = near + far + moves * self.steeper + (1.0 - moves)
        right *= moves[:, None]
        last = len(moves) - 1
        for k in range(1, last + 1):
            part = near[k] / diagonal[k - 1]
            diagonal[k] -= part * far[k - 1]
            right[k] += part * right[k - 1]
        right[last] /= diagonal[last]
        for k in range(last - 1, -1, -1):
            right[k] += far[k] * right[k + 1]
            right[k] /= diagonal[k]
        return right


def _first(values: Array) -> Array:
    """Values (..., K) as (K, ...)."""
    return np.ascontiguousarray(np.moveaxis(values, -1, 0))


def _gained(passed: Array) -> Array:
    """What the pieces' stretch (K, ...) gains by what passes the nodes (K - 1, ...)."""
    gained = np.empty((len(passed) + 1, *passed.shape[1:]))
    gained[0] = 0.0
    gained[1:] = passed
    gained[:-1] -= passed
    return gained
