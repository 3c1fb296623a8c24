"""Arms with friction or creep along their paths from rest to rest: each rest depends on the last.

Cables are chains of elastic pieces that stick or slide at their guides. The P = 2J + 2 pieces of a
cable are the one at the sensor, the run, then by joint the one across it and the one inside its
segment; the G = 2J + 1 guides between them are a pulley, and the plates. The tensions on both
sides of a guide stay within a factor exp(mu theta) of each other (L. Euler 1762; J. A. Eytelwein
1808), and cable passes only at that bound, towards the higher tension. While it sticks, a piece's
tension follows its own stretch alone.

The cables come to rest at every guess of the joint angles, and Newton's steps find the angles at
which the joints rest too.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_plants.arm import statics
from cablesense_plants.arm.body import Body
from cablesense_plants.arm.statics import SpanGeometry, spans, turns
from cablesense_plants.cases import NO_FAULT, PlantError

_ENOUGH_N = 1e-6
_ENOUGH_NM = 1e-7
_GUIDE_ENOUGH_N = 1e-7
_MOST_STEPS = 400
_MOST_HALVINGS = 4
_BLOCK_SWEEPS = 15
_MOST_SWEEPS = 80
_LONGEST_RAD = 0.03
_STRIBECK_RAD_S = 0.02
"""Over which the friction of joints falls to that of turning ones."""


@dataclass(frozen=True)
class PlantFriction:
    """Friction of M cables and J joints, by default none.

    Attributes:
        coefficient: (M,) of each cable on its guides, while it slides.
        breakaway: the same of a cable that sticks, by that of one that slides.
        pulley_rad: constant wrap on a pulley at the actuator, behind the sensor.
        presliding_m: sliding over which bristles take up the cables' friction; 0 sticks rigidly.
        rounded: whether bristles yield gradually, see `_friction_state`.
        actuator_share: part of a cable's compliance before the pulley, as its actuator's; above 0.
        same_before: whether as much lies before every pulley as there does on the average.
        weightless: whether nothing has slid since the straight arm was tensioned without weight.
        joint_nm: (J, 2) torque of the joints' friction while they turn.
        joint_reach_rad: angle over which the joints' friction builds up.
        joint_rounded: whether it does so little by little.
        joint_breakaway: friction of a joint at rest, by that of a turning one (Stribeck).
    """

    coefficient: Array = NO_FAULT
    breakaway: float = 1.0
    pulley_rad: float = 0.0
    presliding_m: float = 0.0
    rounded: bool = False
    actuator_share: float = 0.3
    same_before: bool = False
    weightless: bool = False
    joint_nm: Array = NO_FAULT
    joint_reach_rad: float = 2e-4
    joint_rounded: bool = False
    joint_breakaway: float = 1.0


@dataclass(frozen=True)
class Creep:
    """Kelvin-Voigt elements in series with the cables, K of them; by default one that is rigid.

    Each piece of a cable creeps by its own tension and its share of the compliance.

    Attributes:
        compliance_m_n: (K, M) each one's lengthening when it has settled.
        time_s: (K,) in which it does.
        settled: share of the lengthening under the first tension that came before the arm was
            tensioned; 1 leaves a rest constant, 0 is a new cable.
    """

    compliance_m_n: Array = field(default_factory=lambda: np.zeros((1, 1)))
    time_s: Array = field(default_factory=lambda: np.ones(1))
    settled: float = 1.0


class PathState(NamedTuple):
    """One row of a path.

    Attributes:
        angles_rad: (2J,).
        tension_n: (M, P) of the pieces of the cables; the first is what the sensor measures, and a
            slack one's is negative.
        fed_m: (M, G) unstretched cable beyond each guide.
        bristle: (M, G) deflection of the bristles by the largest, -1 to 1; 0 without bristles.
        sliding: (M, G) 1 where cable passes outwards, -1 inwards, 0 where it sticks.
        joint_state: (2J,) state of friction in the joints.
        speed_rad_s: (2J,) of the angles.
        crept_m: (K, M, P) lengthening of each element of creep.
        retensioned_m: (M,) by which cables that had crept before were shortened.
        paid_out_m: (M,) by the actuators.
        loads_n: (L, 3), at the points that `statics.torques` names.
    """

    angles_rad: Array
    tension_n: Array
    fed_m: Array
    bristle: Array
    sliding: Array
    joint_state: Array
    speed_rad_s: Array
    crept_m: Array
    retensioned_m: Array
    paid_out_m: Array
    loads_n: Array

    @property
    def sensed_n(self) -> Array:
        """(M,) at the actuators, noise-free; 0 where a cable is slack."""
        return np.maximum(self.tension_n[:, 0], 0.0)


class _Pull(NamedTuple):
    """Cables at joint angles: tension (M,) without friction, grip and fed if slack (M, G)."""

    even_n: Array
    grip: Array
    slack_fed_m: Array


class _Law(NamedTuple):
    """Unsolved misfit of chains at a guess: (M, P), matrix (M, P, P), and by lengths (M, P)."""

    misfit_n: Array
    matrix: Array
    by_length_n_m: Array
    fed_m: Array
    bristle: Array


class PathBalance(NamedTuple):
    """The balance of the joints at a guess of their angles, with the cables at rest.

    Attributes:
        torque_nm: (2J,) left on them.
        slope_nm_rad: (2J, 2J) its derivative.
        by_angle_n_rad: (M, P, 2J) derivative of the tensions.
        misfit_n: largest unsolved misfit of a cable.
        state: what would change: angles, tensions, guides, and friction in the joints.
    """

    torque_nm: Array
    slope_nm_rad: Array
    by_angle_n_rad: Array
    misfit_n: float
    state: PathState

    @property
    def settled(self) -> bool:
        """Whether this is rest."""
        return bool(self.misfit_n < _ENOUGH_N and np.abs(self.torque_nm).max() < _ENOUGH_NM)


class QuasiStaticPath:
    """Takes an arm from row to row."""

    def __init__(self, body: Body, friction: PlantFriction, creep: Creep, run_m: float) -> None:
        """The arm's body, its friction and creep, and the run before the base plate."""
        if body.exponent != 1.0:
            raise PlantError("hardening cables have no friction or creep here; use exponent 1")
        joints = body.joint_count
        pieces = 2 * joints + 2
        self.body = body
        self.friction = friction
        self.creep = creep
        self._compliance_m_n = piece_compliance_m_n(
            body, run_m, friction.actuator_share, friction.same_before
        )
        self._straight_m = statics.cable_lengths_m(body, np.zeros((1, 2 * joints)))[0]
        share = self._compliance_m_n * body.stiffness_n_m[:, None]
        self._creep_m_n = creep.compliance_m_n[..., None] * share
        self._across = 2 * np.arange(joints) + 2
        self._distal = np.zeros((pieces, joints))
        self._distal[:2] = 1.0
        self._distal[2::2] = np.triu(np.ones((joints, joints)))
        self._distal[3::2] = np.triu(np.ones((joints, joints)), 1)
        self._beyond = np.triu(np.ones((pieces, pieces)))[1:]

    def start(self, command_rad: Array, paid_out_m: Array, loads_n: Array) -> PathState:
        """First row (2N,), (M,), (L, 3), before any sliding or after that under its weight."""
        body = self.body
        if self.friction.weightless:
            angles = np.zeros((1, 2 * body.joint_count))
            tensions = body.pretension_n[None]
            actuated = np.zeros_like(paid_out_m), np.zeros_like(loads_n)
        else:
            guess = statics.commanded_angles_rad(body, command_rad[None])
            angles, tensions = statics.find_rest(body, guess, paid_out_m[None], loads_n[None])
            actuated = paid_out_m, loads_n
        tension = np.repeat(tensions[0][:, None], self._compliance_m_n.shape[-1], axis=-1)
        crept = self.creep.settled * self._creep_m_n * np.maximum(tension, 0.0)
        length = spans(body, angles, turns(body, angles)).length_m[0]
        fed = self._fed_m(length, tension, crept.sum(axis=0))
        zero = np.zeros_like(fed)
        still = np.zeros_like(angles[0])
        first = PathState(
            angles[0],
            tension,
            fed,
            zero,
            zero,
            still,
            still,
            crept,
            crept.sum(axis=(0, 2)),
            *actuated,
        )
        return self._settle(first, paid_out_m, loads_n, 0) if self.friction.weightless else first

    def advance(
        self, state: PathState, paid_out_m: Array, loads_n: Array, period_s: float
    ) -> PathState:
        """The next row (M,), (L, 3), after a period.

        `paid_out_m` is cable by the actuators, less that of the straight arm: `RealArm.held_m` of
        commands, and offsets.

        Raises:
            PlantError: it has no rest.
        """
        moved = self._settle(state, paid_out_m, loads_n, 0)
        statics.require_room(self.body, moved.angles_rad[None])
        kept = np.exp(-period_s / self.creep.time_s)[:, None, None]
        wanted = self._creep_m_n * np.maximum(moved.tension_n, 0.0)
        speed = (moved.angles_rad - state.angles_rad) / period_s
        crept = wanted + kept * (state.crept_m - wanted)
        return moved._replace(speed_rad_s=speed, crept_m=crept)

    def _settle(
        self, state: PathState, paid_out_m: Array, loads_n: Array, halvings: int
    ) -> PathState:
        """By Newton's steps, else halfway first."""
        asked = state._replace(paid_out_m=paid_out_m, loads_n=loads_n)
        present = self.balance(asked, state.angles_rad, None)
        damping = np.zeros(1)
        for _ in range(_MOST_STEPS):
            if present.settled:
                break
            (move,) = statics.newton_step_rad(
                present.torque_nm[None], present.slope_nm_rad[None], damping
            )
            move *= min(1.0, _LONGEST_RAD / np.abs(move).max())
            tension = present.state.tension_n + present.by_angle_n_rad @ move
            guess = present.state._replace(tension_n=tension)
            tried = self.balance(asked, present.state.angles_rad + move, guess)
            better = tried.torque_nm @ move >= -0.5 * (present.torque_nm @ move)
            present = tried if better else present
            damping = statics.damped(damping, np.array([better]))
        if present.settled:
            return present.state
        if halvings >= _MOST_HALVINGS:
            raise PlantError(
                "an arm with friction found no rest; smaller loads or angles leave it stable"
            )
        halfway = 0.5 * (state.paid_out_m + paid_out_m), 0.5 * (state.loads_n + loads_n)
        between = self._settle(state, *halfway, halvings + 1)
        return self._settle(between, paid_out_m, loads_n, halvings + 1)

    def balance(
        self, before: PathState, angles_rad: Array, guess: PathState | None
    ) -> PathBalance:
        """The balance at angles (2J,) under the lengths and loads of a state, and after the rest.

        `guess` has tensions and sliding nearby.
        """
        body = self.body
        friction = self.friction
        turning = turns(body, angles_rad[None])
        across = spans(body, angles_rad[None], turning, with_bends=True)
        pull = self._pull(before, across)
        tension, sliding, law = self._at_rest(before, pull, guess or before, even=guess is None)
        slope = across.slope_m_rad[0]
        lengthening = np.repeat(self._distal, 2, axis=1) * slope.reshape(-1, 1, body.cable_count).T
        by_angle = np.linalg.solve(law.matrix, law.by_length_n_m[..., None] * lengthening)
        pulling = np.maximum(tension[:, self._across], 0.0).T[None]
        outer = statics.torques(body, angles_rad[None], turning, before.loads_n[None])
        (torque,), (matrix,) = statics.with_cable_torques(across, pulling, *outer)
        taut = tension[:, self._across, None] > 0.0
        stiffness = slope @ np.swapaxes(by_angle[:, self._across] * taut, 0, 1)
        matrix = matrix - stiffness.reshape(matrix.shape)
        joint_state, joint_slope = _friction_state(
            friction.joint_rounded,
            before.joint_state,
            angles_rad - before.angles_rad,
            friction.joint_reach_rad,
        )
        speed = before.speed_rad_s / _STRIBECK_RAD_S
        stribeck = 1.0 + (friction.joint_breakaway - 1.0) * np.exp(-(speed**2))
        level = np.ravel(friction.joint_nm) * stribeck
        matrix -= np.diag(level * joint_slope)
        state = before._replace(
            angles_rad=angles_rad,
            tension_n=tension,
            fed_m=law.fed_m,
            bristle=law.bristle,
            sliding=np.where(pull.grip > 0.0, sliding, 0.0),
            joint_state=joint_state,
        )
        misfit_n = float(np.abs(law.misfit_n).max())
        return PathBalance(torque - level * joint_state, matrix, by_angle, misfit_n, state)

    def _fed_m(self, length_m: Array, tension_n: Array, crept_m: Array) -> Array:
        """(M, G) of spans (J, M), tensions (M, P) and lengthenings by creep (M, P)."""
        stretched = (self._compliance_m_n * tension_n + crept_m) @ self._beyond.T
        return np.asarray((self._distal[1:] @ length_m).T - stretched)

    def _pull(self, before: PathState, across: SpanGeometry) -> _Pull:
        body = self.body
        length = across.length_m[0]
        crept = before.crept_m.sum(axis=0)
        cable_m = self._straight_m + before.paid_out_m - before.retensioned_m
        longer = length.sum(axis=0) - cable_m - crept.sum(axis=-1)
        even = body.pretension_n + body.stiffness_n_m * longer
        bends = across.bend_rad[0].reshape(-1, body.cable_count).T
        wrap = np.insert(bends, 0, self.friction.pulley_rad, axis=1)
        coefficient = (self.friction.coefficient + np.zeros(body.cable_count))[:, None]
        grip = coefficient * wrap * (even > 0.0)[:, None]  # slack cables even out
        return _Pull(even, grip, self._fed_m(length, np.zeros_like(crept), crept))

    def _at_rest(
        self, before: PathState, pull: _Pull, guess: PathState, *, even: bool
    ) -> tuple[Array, Array, _Law]:
        """Tensions (M, P) and sliding of cables at rest, from a guess of both or even tensions."""
        tension = guess.tension_n.copy()
        sliding = guess.sliding
        if even:
            tension[:] = pull.even_n[:, None]
        rigid = not self.friction.presliding_m
        unsettled = np.ones((len(tension), 1), dtype=bool)
        law = self._law(before, pull, tension, sliding)
        for sweep in range(_MOST_SWEEPS):
            step = np.linalg.solve(law.matrix, law.misfit_n[..., None])[..., 0]
            tension = tension - unsettled * step * (1.0 if rigid else 0.97 ** max(0, sweep - 5))
            if rigid:
                new = self._sliding(before, pull, tension, sliding, sweep)
                sliding = np.where(unsettled, new, sliding)
            law = self._law(before, pull, tension, sliding)
            unsettled &= np.abs(law.misfit_n).max(axis=-1, keepdims=True) > _GUIDE_ENOUGH_N
            if not unsettled.any():
                break
        return tension, sliding, law

    def _law(self, before: PathState, pull: _Pull, tension: Array, sliding: Array) -> _Law:
        """First that the pieces' stretch adds up, then at each guide that it sticks or slides."""
        stiff = self.body.stiffness_n_m[:, None]
        c = self._compliance_m_n
        fed = pull.slack_fed_m - (c * tension) @ self._beyond.T
        moved = fed - before.fed_m
        if self.friction.presliding_m:
            state, slope = _friction_state(
                self.friction.rounded, before.bristle, moved, self.friction.presliding_m
            )
            state = np.where(pull.grip > 0.0, state, 0.0)
            ratio = np.exp(pull.grip * state)
            slips = np.ones_like(fed)
            hold = np.maximum(ratio * tension[:, :-1], 0.0) * pull.grip * slope
            at_guides = tension[:, 1:] - ratio * tension[:, :-1]
        else:
            state = np.zeros_like(fed)
            stuck = (sliding == 0.0) & (pull.grip > 0.0)
            ratio = np.exp(pull.grip * sliding)
            slips = np.where(stuck, 0.0, 1.0)
            hold = np.where(stuck, stiff, 0.0)
            at_guides = np.where(stuck, -stiff * moved, tension[:, 1:] - ratio * tension[:, :-1])
        total = (stiff * c * tension).sum(axis=-1) - pull.even_n
        matrix = np.empty((*tension.shape, tension.shape[-1]))
        matrix[:, 0] = stiff * c
        matrix[:, 1:] = (hold[..., None] * self._beyond) * c[:, None, :]
        guide = np.arange(fed.shape[-1])
        matrix[:, guide + 1, guide + 1] += slips
        matrix[:, guide + 1, guide] -= slips * ratio
        misfit = np.concatenate([total[:, None], at_guides], axis=-1)
        return _Law(misfit, matrix, np.concatenate([stiff, hold], axis=-1), fed, state)

    def _sliding(
        self, before: PathState, pull: _Pull, tension: Array, sliding: Array, sweep: int
    ) -> Array:
        """New sliding of the guides: some break loose; those that would slide uphill stop."""
        nearer = tension[:, :-1]
        farther = tension[:, 1:]

        def excess(high: Array, low: Array, sign: float) -> Array:
            """Tension over the bound, which is higher where cable does not slide that way yet."""
            level = np.where(before.sliding == sign, 1.0, self.friction.breakaway)
            return np.asarray(high - low * np.exp(pull.grip * level))

        outwards = excess(farther, nearer, 1.0)
        inwards = excess(nearer, farther, -1.0)
        loose = np.where(outwards > inwards, 1.0, -1.0)
        loose = np.where(np.maximum(outwards, inwards) > _GUIDE_ENOUGH_N, loose, 0.0)
        fed = pull.slack_fed_m - (self._compliance_m_n * tension) @ self._beyond.T
        moved_n = self.body.stiffness_n_m[:, None] * (fed - before.fed_m)
        uphill = sliding * moved_n < -_GUIDE_ENOUGH_N
        new = np.where(sliding == 0.0, loose, np.where(uphill, 0.0, sliding))
        new = np.where(pull.grip > 0.0, new, 0.0)
        if sweep < _BLOCK_SWEEPS:
            return new
        first = np.argmax(new != sliding, axis=-1)[:, None]  # one at a time cannot go in circles
        return np.where(np.arange(new.shape[-1]) == first, new, sliding)


def _friction_state(
    rounded: bool, state: Array, moved: Array, reach: float
) -> tuple[Array, Array]:
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


def piece_compliance_m_n(
    body: Body, run_m: float, actuator_share: float, same_before: bool = False
) -> Array:
    """(M, P) compliance of the pieces, by their lengths; it adds up to the cable's 1 / stiffness.

    `actuator_share` of it is the actuator's, in the piece at the sensor: of each cable, or of one
    of average length, whose piece at the sensor all have.
    """
    length = np.zeros((2 * body.joint_count + 2, body.cable_count))
    length[1] = run_m
    length[2::2] = np.linalg.norm(body.after_m - body.before_m, axis=-1) * body.passes
    length[3:-1:2] = np.linalg.norm(body.inside_m, axis=-1) * body.passes[1:]
    behind = length.sum(axis=0)
    before = behind.mean() if same_before else behind
    length[0] = actuator_share / (1.0 - actuator_share) * before
    return np.asarray((length / length.sum(axis=0) / body.stiffness_n_m).T)
