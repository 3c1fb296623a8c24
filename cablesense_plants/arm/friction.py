"""Arms with friction or creep along their paths from rest to rest: each rest depends on the last.

Cables are chains of elastic pieces that stick or slide at their guides. The pieces of a cable are
the one at the sensor, the run, then by joint the one across it and the one inside its segment; the
guides between them are a pulley, and the plates. The tensions on both sides of a guide stay within
a factor exp(mu theta) of each other (L. Euler 1762; J. A. Eytelwein 1808), and cable passes only
at that bound, towards the higher tension. While it sticks, a piece's tension follows its own
stretch alone.

B arms of one kind are followed side by side. Their cables come to rest at every guess of the joint
angles, and Newton's steps find the angles at which the joints rest too.
"""

from __future__ import annotations

from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_plants.arm import statics
from cablesense_plants.arm.body import Body, Creep, Ints, PlantFriction
from cablesense_plants.arm.statics import SpanGeometry, spans, turns
from cablesense_plants.cases import PlantError

_GUIDE_ENOUGH_N, _ENOUGH_N, _ENOUGH_NM = 1e-7, 1e-6, 1e-7
_BLOCK_SWEEPS, _MOST_SWEEPS = 15, 80
_MOST_STEPS, _MOST_HALVINGS = 40, 7
_LONGEST_RAD = 0.03

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
            own = _rows(each, left)
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


class PathState(NamedTuple):
    """One row of B paths.

    Attributes:
        angles_rad: (B, 2J).
        tension_n: (B, M, P) of the pieces of the cables; the first is what the sensor measures,
            and a slack one's is negative.
        guides: state of the cables at their guides.
        joint_state: (B, 2J) state of friction in the joints.
        speed_rad_s: (B, 2J) of the angles.
        crept_m: (B, K, M, P) lengthening of each element of creep.
        retensioned_m: (B, M) by which cables that had crept before were shortened.
        paid_out_m: (B, M) by the actuators.
        loads_n: (B, P, 3), at the points that `statics.torques` names.
    """

    angles_rad: Array
    tension_n: Array
    guides: GuideState
    joint_state: Array
    speed_rad_s: Array
    crept_m: Array
    retensioned_m: Array
    paid_out_m: Array
    loads_n: Array

    @property
    def sensed_n(self) -> Array:
        """(B, M) at the actuators, noise-free; 0 where a cable is slack."""
        return np.maximum(self.tension_n[..., 0], 0.0)


class PathBalance(NamedTuple):
    """The balance of the joints at guesses of their angles, with the cables at rest.

    Attributes:
        angles_rad: (B, 2J) the guesses.
        torque_nm: (B, 2J) left on them.
        slope_nm_rad: (B, 2J, 2J) its derivative.
        joint_state: (B, 2J) what the state of friction in the joints would become.
        chains: what the cables would do.
    """

    angles_rad: Array
    torque_nm: Array
    slope_nm_rad: Array
    joint_state: Array
    chains: Chains

    def settled(self) -> NDArray[np.bool_]:
        """(B,) whether this is rest."""
        cables = self.chains.misfit_n.max(axis=-1) < _ENOUGH_N
        return np.asarray(cables & (np.abs(self.torque_nm).max(axis=-1) < _ENOUGH_NM))


class QuasiStaticPath:
    """Takes arms from row to row."""

    def __init__(self, body: Body, friction: PlantFriction, creep: Creep, run_m: float) -> None:
        """The arms' body, its friction and creep, and the run before the base plate."""
        if body.exponent != 1.0:
            raise PlantError("hardening cables have no friction or creep here; use exponent 1")
        joints = body.joint_count
        self.body, self.friction, self.creep = body, friction, creep
        self.cables = PlantCables(body, friction, run_m)
        self.straight_m = statics.cable_lengths_m(body, np.zeros((1, 2 * joints)))[0]
        share = self.cables.compliance_m_n * body.stiffness_n_m[:, None]
        self.creep_m_n = creep.compliance_m_n[..., None] * share
        self.across = 2 * np.arange(joints) + 2

    def start(self, command_rad: Array, paid_out_m: Array, loads_n: Array) -> PathState:
        """First rows (B, 2N), (B, M), (B, P, 3) before any sliding."""
        body = self.body
        angles = statics.commanded_angles_rad(body, command_rad)
        angles, tensions = statics.find_rest(body, angles, paid_out_m, loads_n)
        pieces = self.cables.compliance_m_n.shape[-1]
        tension = np.repeat(tensions[..., None], pieces, axis=-1)
        crept = self.creep.settled * self.creep_m_n * np.maximum(tension, 0.0)[:, None]
        length = spans(body, angles, turns(body, angles)).length_m
        fed = self.cables.fed_m(length, tension, crept.sum(axis=1))
        zero, still = np.zeros_like(fed), np.zeros_like(angles)
        return PathState(
            angles, tension, GuideState(fed, zero, zero), still, still, crept,
            crept.sum(axis=(1, 3)), paid_out_m, loads_n,
        )  # fmt: skip

    def advance(
        self, state: PathState, paid_out_m: Array, loads_n: Array, period_s: float
    ) -> PathState:
        """The next rows (B, M), (B, P, 3), after a period.

        `paid_out_m` is cable by the actuators, less that of the straight arm: `RealArm.held_m` of
        commands, and offsets.

        Raises:
            PlantError: one has no rest.
        """
        moved = self._settle(state, paid_out_m, loads_n, 0)
        statics.require_room(self.body, moved.angles_rad)
        kept = np.exp(-period_s / self.creep.time_s)[:, None, None]
        wanted = self.creep_m_n * np.maximum(moved.tension_n, 0.0)[:, None]
        speed = (moved.angles_rad - state.angles_rad) / period_s
        crept = wanted + kept * (state.crept_m - wanted)
        return moved._replace(speed_rad_s=speed, crept_m=crept)

    def _settle(
        self, state: PathState, paid_out_m: Array, loads_n: Array, halvings: int
    ) -> PathState:
        at, settled = self._search(state, paid_out_m, loads_n)
        new = state._replace(
            angles_rad=at.angles_rad, tension_n=at.chains.tension_n, guides=at.chains.guides,
            joint_state=at.joint_state, paid_out_m=paid_out_m, loads_n=loads_n,
        )  # fmt: skip
        lost = np.flatnonzero(~settled)
        if not len(lost):
            return new
        if halvings >= _MOST_HALVINGS:
            raise PlantError(
                "an arm with friction found no rest; smaller loads or angles leave it stable"
            )
        old, paid, loads = _rows(state, lost), paid_out_m[lost], loads_n[lost]
        halfway = 0.5 * (old.paid_out_m + paid), 0.5 * (old.loads_n + loads)
        between = self._settle(old, *halfway, halvings + 1)
        found = self._settle(between, paid, loads, halvings + 1)
        return _with_rows(new, lost, found)

    def _search(
        self, state: PathState, paid_out_m: Array, loads_n: Array
    ) -> tuple[PathBalance, NDArray[np.bool_]]:
        """Rests where Newton's steps find them, and (B,) whether they did."""
        at = self.balance(state, paid_out_m, loads_n, state.angles_rad, None)
        damping = np.zeros(len(paid_out_m))
        settled = at.settled()
        for _ in range(_MOST_STEPS):
            left = np.flatnonzero(~settled)
            if not len(left):
                break
            was, own = _rows(at, left), _rows(state, left)
            move = statics.newton_step_rad(was.torque_nm, was.slope_nm_rad, damping[left])
            move *= np.minimum(1.0, _LONGEST_RAD / np.abs(move).max(axis=-1))[:, None]
            follow = (was.chains.by_angle_n_rad @ move[:, None, :, None])[..., 0]
            guess = was.chains._replace(tension_n=was.chains.tension_n + follow)
            there = was.angles_rad + move
            found = self.balance(own, paid_out_m[left], loads_n[left], there, guess)
            work, before = (found.torque_nm * move).sum(-1), (was.torque_nm * move).sum(-1)
            better = work >= -0.5 * before
            at = _with_rows(at, left[better], _rows(found, np.flatnonzero(better)))
            settled[left[better]] = found.settled()[better]
            damping[left] = statics.damped(damping[left], better)
        return at, settled

    def balance(
        self,
        state: PathState,
        paid_out_m: Array,
        loads_n: Array,
        angles_rad: Array,
        guess: Chains | None,
    ) -> PathBalance:
        """The balance at angles (B, 2J) after a state; `guess` is that of the cables nearby."""
        body, friction = self.body, self.friction
        turning = turns(body, angles_rad)
        across = spans(body, angles_rad, turning, with_bends=True)
        given = self.straight_m + paid_out_m - state.retensioned_m
        longer = across.length_m.sum(axis=1) - given
        crept = state.crept_m.sum(axis=1)
        chains = self.cables.at_rest(state.guides, across, longer, crept, guess)
        pulling = np.swapaxes(np.maximum(chains.tension_n[..., self.across], 0.0), -1, -2)
        outer = statics.torques(body, angles_rad, turning, loads_n)
        torque, slope = statics.with_cable_torques(across, pulling, *outer)
        taut = chains.tension_n[:, :, self.across, None] > 0.0
        stiffness = chains.by_angle_n_rad[:, :, self.across] * taut
        stiffness = across.slope_m_rad @ np.swapaxes(stiffness, 1, 2)
        slope = slope - stiffness.reshape(slope.shape)
        turned = angles_rad - state.angles_rad
        joint_state, joint_slope = friction_state(
            friction.joint_rounded, state.joint_state, turned, friction.joint_reach_rad
        )
        speed = np.abs(state.speed_rad_s) / friction.speed_rad_s
        stribeck = 1.0 + (friction.joint_breakaway - 1.0) * np.exp(-(speed**2))
        level = np.ravel(friction.joint_nm) * stribeck
        each = np.arange(angles_rad.shape[1])
        slope[:, each, each] -= level * joint_slope
        return PathBalance(angles_rad, torque - level * joint_state, slope, joint_state, chains)


def _rows(whole: _Rows, rows: Ints) -> _Rows:
    """Chosen rows of all arrays of a named tuple, and of those within it."""
    parts = (_rows(part, rows) if isinstance(part, tuple) else part[rows] for part in whole)
    return type(whole)(*parts)


def _with_rows(whole: _Rows, rows: Ints, new: _Rows) -> _Rows:
    """The named tuple with other rows in all of its arrays."""
    parts = []
    for old, part in zip(whole, new, strict=True):
        if isinstance(old, tuple):
            parts.append(_with_rows(old, rows, part))
        else:
            parts.append(old.copy())
            parts[-1][rows] = part
    return type(whole)(*parts)
