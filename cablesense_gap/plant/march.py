"""An arm that rubs and creeps, row after row: each rest depends on those before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.plant.balance import Balance, Balances
from cablesense_gap.plant.body import Body
from cablesense_gap.plant.geometry import spans, turns
from cablesense_gap.plant.plant_error import PlantError
from cablesense_gap.plant.rest import commanded_angles_rad, downhill_rad, find_rest, require_room
from cablesense_gap.plant.rubbing import Creep, Rubbing
from cablesense_gap.plant.state import State

Array = NDArray[np.float64]

_QUICK_STEPS, _PATIENT_STEPS = 10, 60
_DEEPEST = 6
_LONGEST_RAD = 0.03
_CABLES_REST_N = 1e-7


class March:
    """Takes an arm from row to row."""

    def __init__(self, body: Body, rubbing: Rubbing, creep: Creep, run_m: float) -> None:
        """From the arm's body, what rubs and creeps, and the run before the base plate."""
        if body.exponent != 1.0:
            raise PlantError("cables that harden cannot rub or creep here; use exponent 1")
        self.body, self.creep = body, creep
        self.balances = Balances(body, rubbing, run_m)
        self.retensioned_m = np.zeros(body.cable_count)

    def start(self, command_rad: Array, paid_out_m: Array, loads_n: Array) -> State:
        """A first row (2N,), (M,), (N, 3) in which nothing has rubbed yet."""
        body = self.body
        angles = commanded_angles_rad(body, command_rad[None])
        rest = find_rest(body, angles, paid_out_m[None], loads_n[None])
        tension = np.tile(rest.tensions_n[0], (2 * body.joint_count + 2, 1))
        crept = self.creep.settled * self.creep.compliance_m_n * tension[0]
        self.retensioned_m = crept.sum(axis=0)
        length = spans(body, rest.angles_rad, turns(body, rest.angles_rad)).length_m[0]
        fed = self.balances.fed_m(length, tension)
        zero = np.zeros(len(angles[0]))
        return State(
            rest.angles_rad[0],
            tension,
            np.zeros_like(fed),
            fed,
            zero,
            zero,
            crept,
            paid_out_m,
            loads_n,
        )

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

    def _settle(self, state: State, paid_out_m: Array, loads_n: Array, depth: int) -> State:
        for search in (self._quick, self._patient):
            found = search(state, paid_out_m, loads_n)
            if found is not None:
                return found
        if depth >= _DEEPEST:
            raise PlantError(
                "an arm that rubs found no rest; smaller loads or angles leave it stable"
            )
        halfway = 0.5 * (state.paid_out_m + paid_out_m), 0.5 * (state.loads_n + loads_n)
        between = self._settle(state, *halfway, depth + 1)
        return self._settle(between, paid_out_m, loads_n, depth + 1)

    def _wanted_m(self, state: State, paid_out_m: Array) -> Array:
        crept = state.crept_m.sum(axis=0) - self.retensioned_m
        return self.balances.straight_m + paid_out_m + crept

    def _quick(self, state: State, paid_out_m: Array, loads_n: Array) -> State | None:
        angles, tension = state.angles_rad, state.tension_n
        wanted_m = self._wanted_m(state, paid_out_m)
        for _ in range(_QUICK_STEPS):
            at = self.balances.at(state, angles, tension, wanted_m, loads_n)
            if at.settled:
                return _moved(state, angles, tension, at, paid_out_m, loads_n)
            turn, pull = _newton_step(at)
            angles, tension = angles + turn, tension + pull
            if not np.isfinite(tension).all():
                return None
        return None

    def _patient(self, state: State, paid_out_m: Array, loads_n: Array) -> State | None:
        """As `_quick`, with the cables at rest at every guess: slower, and hardly ever lost."""
        angles, stiffening = state.angles_rad, 0.0
        wanted_m = self._wanted_m(state, paid_out_m)
        at, tension = self._cables_at_rest(state, angles, state.tension_n, wanted_m, loads_n)
        for _ in range(_PATIENT_STEPS):
            if at.settled:
                return _moved(state, angles, tension, at, paid_out_m, loads_n)
            torque, slope, _ = at.condensed()
            move = downhill_rad(torque[None], slope[None], np.array([stiffening]))[0]
            move *= min(1.0, _LONGEST_RAD / max(np.abs(move).max(), 1e-300))
            found = self._cables_at_rest(state, angles + move, tension, wanted_m, loads_n)
            if found[0].torque_nm @ move >= -0.5 * (torque @ move):
                angles = angles + move
                at, tension = found
                stiffening = 0.25 * stiffening if stiffening > 0.02 else 0.0
            else:
                stiffening = max(0.02, 4.0 * stiffening)
        return None

    def _cables_at_rest(
        self, state: State, angles: Array, tension: Array, wanted_m: Array, loads_n: Array
    ) -> tuple[Balance, Array]:
        at = self.balances.at(state, angles, tension, wanted_m, loads_n)
        for step in range(_PATIENT_STEPS):
            if np.abs(at.misfit_n).max() < _CABLES_REST_N:
                break
            change = np.linalg.solve(at.by_tension, at.misfit_n[..., None])[..., 0].T
            tension = tension - change * 0.97 ** max(0, step - 5)
            at = self.balances.at(state, angles, tension, wanted_m, loads_n)
        return at, tension


def _newton_step(at: Balance) -> tuple[Array, Array]:
    """Change of the angles (2J,) and of the pieces' tensions (2J + 2, M)."""
    torque, slope, answer = at.condensed()
    turn = downhill_rad(torque[None], slope[None], np.zeros(1))[0]
    turn *= min(1.0, _LONGEST_RAD / max(np.abs(turn).max(), 1e-300))
    return turn, (answer[..., 0] + answer[..., 1:] @ turn).T


def _moved(
    state: State, angles: Array, tension: Array, at: Balance, paid_out_m: Array, loads_n: Array
) -> State:
    return replace(
        state,
        angles_rad=angles,
        tension_n=tension,
        rub=at.rub,
        fed_m=at.fed_m,
        joint_rub=at.joint_rub,
        paid_out_m=paid_out_m,
        loads_n=loads_n,
    )
