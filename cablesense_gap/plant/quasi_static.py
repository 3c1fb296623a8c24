"""An arm with friction or creep along its quasi-static path: each rest depends on those before.

A cable is cut at its guides. Across one, its tension changes by the factor exp(mu theta s), with
the friction state s there between -1 and 1. The pieces of a cable are the one at the sensor, the
run, then by joint the one across it and the one inside its segment; the guides between them are a
pulley, and the plates.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_gap.plant.body import Body, Creep, Friction, PlantError
from cablesense_gap.plant.geometry import cable_lengths_m, spans, torques, turns
from cablesense_gap.plant.rest import (
    commanded_angles_rad,
    find_rest,
    newton_step_rad,
    require_room,
    with_cable_torques,
)

_ACTUATOR_SHARE = 0.3
"""Part of a cable's compliance that is its actuator's, where the rest is spread."""
_ENOUGH_NM, _ENOUGH_N, _CABLES_REST_N = 1e-7, 1e-6, 1e-7
_NEWTON_STEPS, _DAMPED_STEPS, _MOST_HALVINGS = 10, 60, 6
_LONGEST_RAD = 0.03


@dataclass(frozen=True)
class State:
    """One row of a path.

    Attributes:
        angles_rad: (2J,).
        tension_n: (2J + 2, M) of the pieces of the cables; the first is what the sensor measures.
        guide_state: (2J + 1, M) state of friction at the guides.
        fed_m: (2J + 1, M) cable that has passed each guide.
        joint_state: (2J,) state of friction in the joints.
        speed_rad_s: (2J,) of the angles.
        crept_m: (K, M) lengthening of each element.
        paid_out_m: (M,) by the actuators.
        loads_n: (N, 3).
    """

    angles_rad: Array
    tension_n: Array
    guide_state: Array
    fed_m: Array
    joint_state: Array
    speed_rad_s: Array
    crept_m: Array
    paid_out_m: Array
    loads_n: Array


class Balance(NamedTuple):
    """Residuals at a guess, and their derivatives; P = 2J + 2 pieces of cable.

    Attributes:
        angles_rad: (2J,) of the guess.
        tension_n: (P, M) of the guess.
        torque_nm: (2J,) left on the joint angles.
        torque_slope: (2J, 2J) its derivative at constant tensions of the cables.
        misfit_n: (M, P) of each cable: its stretch, then the slip law at every guide.
        by_tension: (M, P, P) its derivative by the cable's tensions.
        by_angle: (M, P, 2J) its derivative by the angles.
        pull: (2J, M, P) torque by tension.
        guide_state: (P - 1, M) what the state of friction at the guides would become.
        fed_m: (P - 1, M) cable that would have passed the guides.
        joint_state: (2J,) what the state of friction in the joints would become.
    """

    angles_rad: Array
    tension_n: Array
    torque_nm: Array
    torque_slope: Array
    misfit_n: Array
    by_tension: Array
    by_angle: Array
    pull: Array
    guide_state: Array
    fed_m: Array
    joint_state: Array

    @property
    def settled(self) -> bool:
        """Whether this is rest."""
        return bool(
            np.abs(self.torque_nm).max() < _ENOUGH_NM and np.abs(self.misfit_n).max() < _ENOUGH_N
        )

    def step(self, damping: float) -> tuple[Array, Array, Array]:
        """Newton's step (2J,) once the cables follow, the torque then, and how they do.

        None of its angles is over `_LONGEST_RAD`. Cables follow by (M, P, 1 + 2J): to rest at the
        angles of the guess, and with each angle.
        """
        sides = np.concatenate([self.misfit_n[..., None], self.by_angle], axis=-1)
        answer = -np.linalg.solve(self.by_tension, sides)
        pulled = np.einsum("acp,cpb->ab", self.pull, answer)
        torque, slope = self.torque_nm - pulled[:, 0], self.torque_slope - pulled[:, 1:]
        step = newton_step_rad(torque[None], slope[None], np.array([damping]))[0]
        return step * min(1.0, _LONGEST_RAD / max(np.abs(step).max(), 1e-300)), torque, answer


class QuasiStaticPath:
    """Takes an arm from row to row."""

    def __init__(self, body: Body, friction: Friction, creep: Creep, run_m: float) -> None:
        """From the arm's body, its friction and creep, and the run before the base plate."""
        if body.exponent != 1.0:
            raise PlantError("hardening cables have no friction or creep here; use exponent 1")
        joints = body.joint_count
        self.body, self.friction, self.creep = body, friction, creep
        self.compliance_m_n = piece_compliance_m_n(body, run_m, friction.spread)
        self.straight_m = cable_lengths_m(body, np.zeros((1, 2 * joints)))[0]
        self.retensioned_m = np.zeros(body.cable_count)
        self.distal = np.zeros((2 * joints + 1, joints))
        self.distal[0] = 1.0
        self.distal[1::2] = np.triu(np.ones((joints, joints)))
        self.distal[2::2] = np.triu(np.ones((joints, joints)), 1)
        self.across = 2 * np.arange(joints) + 2
        self.of_joint = np.repeat(np.arange(joints), 2)

    def start(self, command_rad: Array, paid_out_m: Array, loads_n: Array) -> State:
        """A first row (2N,), (M,), (N, 3) before any sliding."""
        body = self.body
        angles = commanded_angles_rad(body, command_rad[None])
        angles, tensions = find_rest(body, angles, paid_out_m[None], loads_n[None])
        tension = np.tile(tensions[0], (2 * body.joint_count + 2, 1))
        crept = self.creep.settled * self.creep.compliance_m_n * tension[0]
        self.retensioned_m = crept.sum(axis=0)
        fed = self._fed_m(spans(body, angles, turns(body, angles)).length_m[0], tension)
        zero = np.zeros(len(angles[0]))
        guides = np.zeros_like(fed), fed
        return State(angles[0], tension, *guides, zero, zero, crept, paid_out_m, loads_n)

    def advance(self, state: State, paid_out_m: Array, loads_n: Array, period_s: float) -> State:
        """The next row.

        Raises:
            PlantError: it has no rest.
        """
        moved = self._settle(state, paid_out_m, loads_n, 0)
        kept = np.exp(-period_s / self.creep.time_s)[:, None]
        wanted = self.creep.compliance_m_n * np.maximum(moved.tension_n[1], 0.0)
        require_room(self.body, moved.angles_rad[None])
        speed = (moved.angles_rad - state.angles_rad) / period_s
        crept = wanted + kept * (state.crept_m - wanted)
        return replace(moved, speed_rad_s=speed, crept_m=crept)

    def _settle(self, state: State, paid_out_m: Array, loads_n: Array, halvings: int) -> State:
        crept_m = state.crept_m.sum(axis=0) - self.retensioned_m
        wanted_m = self.straight_m + paid_out_m + crept_m
        at = self._newton(state, wanted_m, loads_n) or self._damped(state, wanted_m, loads_n)
        if at is not None:
            return replace(
                state, angles_rad=at.angles_rad, tension_n=at.tension_n,
                guide_state=at.guide_state, fed_m=at.fed_m, joint_state=at.joint_state,
                paid_out_m=paid_out_m, loads_n=loads_n,
            )  # fmt: skip
        if halvings >= _MOST_HALVINGS:
            raise PlantError(
                "an arm with friction found no rest; smaller loads or angles leave it stable"
            )
        halfway = 0.5 * (state.paid_out_m + paid_out_m), 0.5 * (state.loads_n + loads_n)
        between = self._settle(state, *halfway, halvings + 1)
        return self._settle(between, paid_out_m, loads_n, halvings + 1)

    def _newton(self, state: State, wanted_m: Array, loads_n: Array) -> Balance | None:
        angles, tension = state.angles_rad, state.tension_n
        for _ in range(_NEWTON_STEPS):
            at = self.balance(state, angles, tension, wanted_m, loads_n)
            if at.settled:
                return at
            turn, _torque, answer = at.step(0.0)
            angles = angles + turn
            tension = tension + (answer[..., 0] + answer[..., 1:] @ turn).T
            if not np.isfinite(tension).all():
                return None
        return None

    def _damped(self, state: State, wanted_m: Array, loads_n: Array) -> Balance | None:
        """As `_newton`, with the cables at rest at every guess: slower, and hardly ever fails."""
        damping = 0.0
        at = self._cables_at_rest(state, state.angles_rad, state.tension_n, wanted_m, loads_n)
        for _ in range(_DAMPED_STEPS):
            if at.settled:
                return at
            move, torque, _ = at.step(damping)
            angles = at.angles_rad + move
            found = self._cables_at_rest(state, angles, at.tension_n, wanted_m, loads_n)
            if found.torque_nm @ move >= -0.5 * (torque @ move):
                at = found
                damping = 0.25 * damping if damping > 0.02 else 0.0
            else:
                damping = max(0.02, 4.0 * damping)
        return None

    def _cables_at_rest(
        self, state: State, angles: Array, tension: Array, wanted_m: Array, loads_n: Array
    ) -> Balance:
        at = self.balance(state, angles, tension, wanted_m, loads_n)
        for step in range(_DAMPED_STEPS):
            if np.abs(at.misfit_n).max() < _CABLES_REST_N:
                break
            change = np.linalg.solve(at.by_tension, at.misfit_n[..., None])[..., 0].T
            tension = at.tension_n - change * 0.97 ** max(0, step - 5)
            at = self.balance(state, angles, tension, wanted_m, loads_n)
        return at

    def balance(
        self, state: State, angles: Array, tension: Array, wanted_m: Array, loads_n: Array
    ) -> Balance:
        """The balance at angles (2J,) and tensions (P, M), after a state.

        `wanted_m` (M,) is the unstretched cable that the spans have, `loads_n` (N, 3) the loads.
        """
        body, friction = self.body, self.friction
        turning = turns(body, angles[None])
        across = spans(body, angles[None], turning, with_bends=True)
        length, slope = across.length_m[0], across.slope_m_rad[0].reshape(len(angles), -1)
        bends = across.bend_rad[0].reshape(len(angles), -1)
        pulley = np.full((1, body.cable_count), friction.pulley_rad)
        grip = friction.coefficient * np.concatenate([pulley, bends])
        fed = self._fed_m(length, tension)
        guide, guide_slope = friction_state(
            friction.rounded, state.guide_state, fed - state.fed_m, friction.reach_m
        )
        taut = tension > 0.0
        gained = np.where(taut[:-1], np.expm1(grip * guide), 0.0)
        carried = tension[:-1] * (1.0 + gained)
        sticking = carried * grip * guide_slope * taut[:-1]

        pieces = len(tension)
        stiff, c = body.stiffness_n_m, self.compliance_m_n
        misfit = np.empty((body.cable_count, pieces))
        strain = (c * (tension - body.pretension_n)).sum(axis=0)
        misfit[:, 0] = stiff * (strain - length.sum(axis=0) + wanted_m)
        misfit[:, 1:] = (tension[1:] - carried).T

        by_tension = np.zeros((body.cable_count, pieces, pieces))
        by_tension[:, 1:] = np.triu(np.ones((pieces, pieces)))[1:] * c.T[:, None, :]
        by_tension[:, 1:] *= sticking.T[:, :, None]
        by_tension[:, 0] = (stiff * c).T
        behind = np.arange(1, pieces)
        by_tension[:, behind, behind] += 1.0
        by_tension[:, behind, behind - 1] -= (1.0 + gained).T

        by_angle = np.empty((body.cable_count, pieces, len(angles)))
        by_angle[:, 0] = -stiff[:, None] * slope.T
        beyond = self.distal[:, self.of_joint]
        by_angle[:, 1:] = -(sticking.T[:, :, None] * beyond * slope.T[:, None, :])

        pulling = np.maximum(tension[self.across], 0.0)
        outer = torques(body, angles[None], turning, loads_n[None])
        torque, matrix = (part[0] for part in with_cable_torques(across, pulling[None], *outer))
        each, own = np.arange(len(angles)), self.across[self.of_joint]
        joint_state, joint_slope = friction_state(
            friction.joint_rounded,
            state.joint_state,
            angles - state.angles_rad,
            friction.joint_reach_rad,
        )
        speed = np.abs(state.speed_rad_s) / friction.speed_rad_s
        stribeck = 1.0 + (friction.breakaway - 1.0) * np.exp(-(speed**2))
        level = friction.joint_nm.ravel() * stribeck
        matrix[each, each] -= level * joint_slope

        pull = np.zeros((len(angles), body.cable_count, pieces))
        pull[each, :, own] = slope * taut[own]
        return Balance(
            angles, tension, torque - level * joint_state, matrix, misfit, by_tension, by_angle,
            pull, guide, fed, joint_state,
        )  # fmt: skip

    def _fed_m(self, length_m: Array, tension_n: Array) -> Array:
        """(P - 1, M) unstretched cable beyond each guide, of spans (J, M) and tensions (P, M)."""
        stretched = np.cumsum((self.compliance_m_n * tension_n)[::-1], axis=0)[::-1][1:]
        return self.distal @ length_m - stretched


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


def piece_compliance_m_n(body: Body, run_m: float, spread: bool) -> Array:
    """(2J + 2, M) compliance of the pieces; it adds up to the cable's 1 / stiffness.

    Not spread, all of it is the run's.
    """
    length = np.zeros((2 * body.joint_count + 2, body.cable_count))
    length[1] = run_m
    if spread:
        across = np.linalg.norm(body.after_m - body.before_m, axis=-1)
        length[2::2] = across * body.passes
        inside = body.before_m[1:] - body.after_m[:-1]
        inside[..., 0] += body.spacing_m[1:, None]
        length[3:-1:2] = np.linalg.norm(inside, axis=-1) * body.passes[1:]
    share = length / length.sum(axis=0)
    if spread:
        share *= 1.0 - _ACTUATOR_SHARE
        share[0] = _ACTUATOR_SHARE
    return share / body.stiffness_n_m
