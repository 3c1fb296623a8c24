"""Cables that stick and slide at their guides, at rest at given joint angles.

Cables are chains of elastic pieces that stick or slide at their guides. The pieces of a cable are
the one at the sensor, the run, then by joint the one across it and the one inside its segment; the
guides between them are a pulley, and the plates. The tensions on both sides of a guide stay within
a factor exp(mu theta) of each other (L. Euler 1762; J. A. Eytelwein 1808), and cable passes only
at that bound, towards the higher tension. While it sticks, a piece's tension follows its own
stretch alone.
"""

from __future__ import annotations

from typing import Any, NamedTuple, TypeVar

import numpy as np

from cablesense_base import Array
from cablesense_plants.arm.body import Body, Ints, PlantFriction
from cablesense_plants.arm.statics import SpanGeometry

_GUIDE_ENOUGH_N = 1e-7
_BLOCK_SWEEPS, _MOST_SWEEPS = 15, 80

_Rows = TypeVar("_Rows", bound=tuple[Any, ...])


class GuideState(NamedTuple):
    """State of the cables at their G = 2J + 1 guides.

    Attributes:
        fed_m: (B, M, G) unstretched cable beyond each guide.
        bristle: (B, M, G) deflection of the bristles by the largest, -1 to 1; 0 without bristles.
        sliding: (B, M, G) 1 where cable passes outwards, -1 inwards, 0 where it sticks.
    """

    fed_m: Array
    bristle: Array
    sliding: Array


class Chains(NamedTuple):
    """Cables of B arms at rest, at given joint angles.

    Attributes:
        tension_n: (B, M, P) of the P = 2J + 2 pieces; a slack cable's is negative.
        by_angle_n_rad: (B, M, P, 2J) its derivative by the joint angles.
        misfit_n: (B, M) largest unsolved misfit.
        guides: their state.
    """

    tension_n: Array
    by_angle_n_rad: Array
    misfit_n: Array
    guides: GuideState


class _Each(NamedTuple):
    """Cables side by side, whatever their arm: first axis N = B M."""

    stiffness_n_m: Array
    compliance_m_n: Array
    stretch_n: Array
    grip: Array
    slack_fed_m: Array
    before_fed_m: Array
    before_bristle: Array
    before_sliding: Array


class _Law(NamedTuple):
    """Unsolved misfit of a chain at a guess: (N, P), matrix (N, P, P), and by lengths (N, P)."""

    misfit_n: Array
    matrix: Array
    by_length_n_m: Array
    fed_m: Array
    bristle: Array


class PlantCables:
    """The cables of a body, with their friction."""

    def __init__(self, body: Body, friction: PlantFriction, run_m: float) -> None:
        """`run_m` is the run before the base plate."""
        joints = body.joint_count
        self.body, self.friction = body, friction
        self.compliance_m_n = piece_compliance_m_n(body, run_m, friction.actuator_share)
        self.distal = np.zeros((2 * joints + 2, joints))
        self.distal[:2] = 1.0
        self.distal[2::2] = np.triu(np.ones((joints, joints)))
        self.distal[3::2] = np.triu(np.ones((joints, joints)), 1)
        self._beyond = np.triu(np.ones((2 * joints + 2, 2 * joints + 2)))[1:]
        self._of_joint = np.repeat(np.arange(joints), 2)

    def fed_m(self, length_m: Array, tension_n: Array, crept_m: Array) -> Array:
        """(B, M, G) unstretched cable beyond each guide.

        Takes spans (B, J, M), tensions (B, M, P) and lengthenings by creep (B, M, P).
        """
        stretched = (self.compliance_m_n * tension_n + crept_m) @ self._beyond.T
        return np.asarray(np.swapaxes(self.distal[1:] @ length_m, -1, -2) - stretched)

    def at_rest(
        self,
        before: GuideState,
        across: SpanGeometry,
        longer_m: Array,
        crept_m: Array,
        guess: Chains | None,
    ) -> Chains:
        """Cables at rest across joints, after a state of their guides.

        `longer_m` (B, M) is by how much each cable is longer than under its pretension, without
        what its pieces have crept, `crept_m` (B, M, P).
        """
        rows, cables = longer_m.shape
        rigid, count = not self.friction.reach_m, rows * cables
        each = self._side_by_side(before, across, longer_m, crept_m)
        tension = np.repeat(each.stretch_n[:, None], len(self.distal), axis=-1)
        sliding = each.before_sliding.copy()
        if guess is not None:
            tension = guess.tension_n.reshape(count, -1).copy()
            sliding = guess.guides.sliding.reshape(count, -1).copy()
        law = self._law(each, tension, sliding)
        left = np.arange(count)
        for sweep in range(_MOST_SWEEPS):
            own = chosen_rows(each, left)
            step = np.linalg.solve(law.matrix[left], law.misfit_n[left][..., None])[..., 0]
            tension[left] -= step * (1.0 if rigid else 0.97 ** max(0, sweep - 5))
            if rigid:
                sliding[left] = self._sliding(own, tension[left], sliding[left], sweep)
            for whole, part in zip(law, self._law(own, tension[left], sliding[left]), strict=True):
                whole[left] = part
            left = left[np.abs(law.misfit_n[left]).max(axis=-1) > _GUIDE_ENOUGH_N]
            if not len(left):
                break
        slope = np.moveaxis(across.slope_m_rad.reshape(rows, -1, cables), -1, 1)
        lengthening = self.distal[:, self._of_joint] * slope.reshape(count, 1, -1)
        held = law.by_length_n_m[..., None] * lengthening
        by_angle = np.asarray(np.linalg.solve(law.matrix, held), dtype=float)
        guides = law.fed_m, law.bristle, np.where(each.grip > 0.0, sliding, 0.0)
        return Chains(
            tension.reshape(rows, cables, -1),
            by_angle.reshape(rows, cables, *by_angle.shape[1:]),
            np.abs(law.misfit_n).max(axis=-1).reshape(rows, cables),
            GuideState(*(part.reshape(rows, cables, -1) for part in guides)),
        )

    def _side_by_side(
        self, before: GuideState, across: SpanGeometry, longer_m: Array, crept_m: Array
    ) -> _Each:
        rows, cables = longer_m.shape
        count, body = rows * cables, self.body
        stretch = body.pretension_n + body.stiffness_n_m * (longer_m - crept_m.sum(axis=-1))
        bends = np.moveaxis(across.bend_rad.reshape(rows, -1, cables), -1, 1)
        pulley = np.full((rows, cables, 1), self.friction.pulley_rad)
        coefficient = (self.friction.coefficient + np.zeros(cables))[:, None]
        grip = coefficient * np.concatenate([pulley, bends], axis=-1)
        grip = grip * (stretch > 0.0)[..., None]  # slack cables even out
        slack_fed = self.fed_m(across.length_m, np.zeros_like(crept_m), crept_m)
        return _Each(
            np.tile(body.stiffness_n_m, rows),
            np.tile(self.compliance_m_n, (rows, 1)),
            stretch.ravel(),
            *(part.reshape(count, -1) for part in (grip, slack_fed, *before)),
        )

    def _law(self, each: _Each, tension: Array, sliding: Array) -> _Law:
        """First that the pieces' stretch adds up, then at each guide that it sticks or slides."""
        stiff, c = each.stiffness_n_m[:, None], each.compliance_m_n
        fed = each.slack_fed_m - (c * tension) @ self._beyond.T
        moved = fed - each.before_fed_m
        if self.friction.reach_m:
            state, slope = friction_state(
                self.friction.rounded, each.before_bristle, moved, self.friction.reach_m
            )
            state = np.where(each.grip > 0.0, state, 0.0)
            ratio, slips = np.exp(each.grip * state), np.ones_like(fed)
            hold = np.maximum(ratio * tension[:, :-1], 0.0) * each.grip * slope
            left = tension[:, 1:] - ratio * tension[:, :-1]
        else:
            state, stuck = np.zeros_like(fed), (sliding == 0.0) & (each.grip > 0.0)
            ratio, slips = np.exp(each.grip * sliding), np.where(stuck, 0.0, 1.0)
            hold = np.where(stuck, stiff, 0.0)
            left = np.where(stuck, -stiff * moved, tension[:, 1:] - ratio * tension[:, :-1])
        total = (stiff * c * tension).sum(axis=-1) - each.stretch_n
        matrix = np.empty((*tension.shape, tension.shape[-1]))
        matrix[:, 0] = stiff * c
        matrix[:, 1:] = (hold[..., None] * self._beyond) * c[:, None, :]
        guide = np.arange(fed.shape[-1])
        matrix[:, guide + 1, guide + 1] += slips
        matrix[:, guide + 1, guide] -= slips * ratio
        misfit = np.concatenate([total[:, None], left], axis=-1)
        return _Law(misfit, matrix, np.concatenate([stiff, hold], axis=-1), fed, state)

    def _sliding(self, each: _Each, tension: Array, sliding: Array, sweep: int) -> Array:
        """New sliding of the guides: some break loose; those that would slide uphill stop."""
        nearer, farther = tension[:, :-1], tension[:, 1:]

        def excess(high: Array, low: Array, sign: float) -> Array:
            """Tension over the bound, which is higher where cable does not slide that way yet."""
            level = np.where(each.before_sliding == sign, 1.0, self.friction.breakaway)
            return np.asarray(high - low * np.exp(each.grip * level))

        outwards, inwards = excess(farther, nearer, 1.0), excess(nearer, farther, -1.0)
        loose = np.where(outwards > inwards, 1.0, -1.0)
        loose = np.where(np.maximum(outwards, inwards) > _GUIDE_ENOUGH_N, loose, 0.0)
        fed = each.slack_fed_m - (each.compliance_m_n * tension) @ self._beyond.T
        moved_n = each.stiffness_n_m[:, None] * (fed - each.before_fed_m)
        uphill = sliding * moved_n < -_GUIDE_ENOUGH_N
        new = np.where(sliding == 0.0, loose, np.where(uphill, 0.0, sliding))
        new = np.where(each.grip > 0.0, new, 0.0)
        if sweep < _BLOCK_SWEEPS:
            return new
        first = np.argmax(new != sliding, axis=-1)[:, None]  # one at a time cannot go in circles
        return np.where(np.arange(new.shape[-1]) == first, new, sliding)


def friction_state(rounded: bool, state: Array, moved: Array, reach: float) -> tuple[Array, Array]:
    """New state and its derivative by the distance moved since the state was left.

    Sharp friction is a spring of `reach` that then slides (Prandtl 1928); rounded friction nears
    its full value as exp(-moved / reach) (Dahl 1968). Neither depends on time: what does not
    move keeps its state.
    """
    if not rounded:
        free = state + moved / reach
        return np.clip(free, -1.0, 1.0), (np.abs(free) < 1.0) / reach
    full = np.sign(moved)
    remaining = (full - state) * np.exp(-np.abs(moved) / reach)
    new = np.where(moved == 0.0, state, full - remaining)
    return new, np.where(moved == 0.0, 1.0, np.abs(remaining)) / reach


def piece_compliance_m_n(body: Body, run_m: float, actuator_share: float) -> Array:
    """(M, P) compliance of the pieces, by their lengths; it adds up to the cable's 1 / stiffness.

    `actuator_share` of it is the actuator's, in the piece at the sensor.
    """
    length = np.zeros((2 * body.joint_count + 2, body.cable_count))
    length[1] = run_m
    length[2::2] = np.linalg.norm(body.after_m - body.before_m, axis=-1) * body.passes
    length[3:-1:2] = np.linalg.norm(body.inside_m, axis=-1) * body.passes[1:]
    share = (1.0 - actuator_share) * length / length.sum(axis=0)
    share[0] = actuator_share
    return np.asarray((share / body.stiffness_n_m).T)


def chosen_rows(whole: _Rows, rows: Ints) -> _Rows:
    """Chosen rows of all arrays of a named tuple, and of those within it."""
    parts = (chosen_rows(part, rows) if isinstance(part, tuple) else part[rows] for part in whole)
    return type(whole)(*parts)


def with_rows(whole: _Rows, rows: Ints, new: _Rows) -> _Rows:
    """The named tuple with other rows in all of its arrays."""
    parts = []
    for old, part in zip(whole, new, strict=True):
        if isinstance(old, tuple):
            parts.append(with_rows(old, rows, part))
        else:
            parts.append(old.copy())
            parts[-1][rows] = part
    return type(whole)(*parts)
