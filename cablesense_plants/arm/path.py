"""Arms with friction or creep along their paths from rest to rest: each rest depends on the last.

B arms of one kind are followed side by side. Their cables come to rest at every guess of the joint
angles, and Newton's steps find the angles at which the joints rest too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_plants.arm import statics
from cablesense_plants.arm.body import Body, Creep, PlantFriction
from cablesense_plants.arm.friction import (
    Chains,
    GuideState,
    PlantCables,
    chosen_rows,
    friction_state,
    with_rows,
)
from cablesense_plants.arm.statics import spans, turns
from cablesense_plants.cases import PlantError

_ENOUGH_N, _ENOUGH_NM = 1e-6, 1e-7
_MOST_STEPS, _MOST_HALVINGS = 40, 7
_LONGEST_RAD = 0.03


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
        old, paid, loads = chosen_rows(state, lost), paid_out_m[lost], loads_n[lost]
        halfway = 0.5 * (old.paid_out_m + paid), 0.5 * (old.loads_n + loads)
        between = self._settle(old, *halfway, halvings + 1)
        found = self._settle(between, paid, loads, halvings + 1)
        return with_rows(new, lost, found)

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
            was, own = chosen_rows(at, left), chosen_rows(state, left)
            move = statics.newton_step_rad(was.torque_nm, was.slope_nm_rad, damping[left])
            move *= np.minimum(1.0, _LONGEST_RAD / np.abs(move).max(axis=-1))[:, None]
            follow = (was.chains.by_angle_n_rad @ move[:, None, :, None])[..., 0]
            guess = was.chains._replace(tension_n=was.chains.tension_n + follow)
            there = was.angles_rad + move
            found = self.balance(own, paid_out_m[left], loads_n[left], there, guess)
            work, before = (found.torque_nm * move).sum(-1), (was.torque_nm * move).sum(-1)
            better = work >= -0.5 * before
            at = with_rows(at, left[better], chosen_rows(found, np.flatnonzero(better)))
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
