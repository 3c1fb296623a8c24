"""An arm with whatever is wrong with it, and the noise-free readings of its sensors."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cablesense_base.arrays import Array
from cablesense_gap.plant.body import Body, Nominal, rigid_body
from cablesense_gap.plant.friction import Creep, Friction, no_creep, no_friction
from cablesense_gap.plant.geometry import cable_lengths_m
from cablesense_gap.plant.protocol import Schedule
from cablesense_gap.plant.quasi_static import QuasiStaticPath
from cablesense_gap.plant.rest import follow_path
from cablesense_gap.plant.sensing import Sensing, ideal_sensing

_MASS_SHARE = 0.005
_PRETENSION_N = 0.15
_CONTACT_M = 0.0003
_HOLE_DEG = 0.05
_ZERO_N = 0.05


@dataclass(frozen=True)
class Actuation:
    """Faults of M actuators.

    Attributes:
        play_m: (M,) lost motion on reversal, from end to end.
        play_start: (M,) where in the play each begins, -1 to 1.
        ratio: (M,) metres paid out for one that is commanded.
        screw_m: (M,) amplitude of an error periodic in the length.
        screw_pitch_m: its period.
        screw_phase_rad: (M,) its phase at the straight arm.
        slip_m: (M,) length that each clamp lets through at `slip_time_s`.
        slip_time_s: when.
    """

    play_m: Array
    play_start: Array
    ratio: Array
    screw_m: Array
    screw_pitch_m: float
    screw_phase_rad: Array
    slip_m: Array
    slip_time_s: float

    def paid_out_m(self, commanded_m: Array, time_s: Array) -> Array:
        """(R, M) lengths given, of those commanded, both less that of the straight arm."""
        phase = 2.0 * np.pi * commanded_m / self.screw_pitch_m + self.screw_phase_rad
        uneven = self.screw_m * (np.sin(phase) - np.sin(self.screw_phase_rad))
        slipped = (time_s >= self.slip_time_s)[:, None] * self.slip_m
        return self._with_play(self.ratio * commanded_m) + uneven + slipped

    def _with_play(self, wanted_m: Array) -> Array:
        half = 0.5 * self.play_m
        if not half.any():
            return wanted_m
        given = np.empty_like(wanted_m)
        at = wanted_m[0] + half * self.play_start
        for row, wanted in enumerate(wanted_m):
            at = np.clip(at, wanted - half, wanted + half)
            given[row] = at
        return given


def ideal_actuation(cables: int) -> Actuation:
    """Actuators that pay out exactly what is commanded."""
    zero = np.zeros(cables)
    return Actuation(zero, zero, zero + 1.0, zero, 0.004, zero, zero, np.inf)


@dataclass(frozen=True)
class RealArm:
    """An arm with whatever is wrong with it.

    Attributes:
        nominal: the arm as drawn, by which its actuators are commanded.
        body: joints, holes, masses, cables, springs.
        actuation: faults of the actuators.
        friction: of cables and joints.
        creep: of the cables.
        sensing: faults of the sensors.
        load_turn: (3, 3) from the load that is written down to the one that acts.
    """

    nominal: Nominal
    body: Body
    actuation: Actuation
    friction: Friction
    creep: Creep
    sensing: Sensing
    load_turn: Array

    @property
    def history_dependent(self) -> bool:
        """Whether a rest depends on those before."""
        return self.friction.any or self.creep.any

    def signals_n(self, schedule: Schedule, history: Schedule) -> Array:
        """(R, M) noise-free readings over a schedule, after a history that is not recorded.

        Raises:
            PlantError: the arm finds no rest in some row.
        """
        before = len(history.time_s)
        command = np.concatenate([history.command_rad, schedule.command_rad])
        time_s = np.concatenate([history.time_s, schedule.time_s])
        loads = np.concatenate([history.forces_n, schedule.forces_n]) @ self.load_turn.T
        drawn = rigid_body(self.nominal)
        straight = cable_lengths_m(drawn, np.zeros((1, command.shape[1])))
        wanted = cable_lengths_m(drawn, command) - straight
        paid_out = self.actuation.paid_out_m(wanted, time_s)
        if self.history_dependent:
            tension = self._path_tensions_n(command, paid_out, loads, time_s)
        else:
            tension = follow_path(self.body, command, paid_out, loads).tensions_n
        return self.sensing.signals_n(np.maximum(tension[before:], 0.0), schedule.time_s)

    def _path_tensions_n(
        self, command: Array, paid_out: Array, loads: Array, time_s: Array
    ) -> Array:
        path = QuasiStaticPath(self.body, self.friction, self.creep, self.nominal.run_m)
        state = path.start(command[0], paid_out[0], loads[0])
        tension = np.empty_like(paid_out)
        tension[0] = state.tension_n[0]
        timeless = not self.creep.any and self.friction.breakaway == 1.0
        for row in range(1, len(tension)):
            still = np.array_equal(paid_out[row], paid_out[row - 1])
            if not (timeless and still and np.array_equal(loads[row], loads[row - 1])):
                period_s = float(time_s[row] - time_s[row - 1])
                state = path.advance(state, paid_out[row], loads[row], period_s)
            tension[row] = state.tension_n[0]
        return tension


def ideal_arm(nominal: Nominal) -> RealArm:
    """The arm exactly as drawn."""
    body = rigid_body(nominal)
    return RealArm(
        nominal=nominal,
        body=body,
        actuation=ideal_actuation(nominal.cable_count),
        friction=no_friction(body),
        creep=no_creep(body),
        sensing=ideal_sensing(nominal.cable_count, nominal.pretension_n),
        load_turn=np.eye(3),
    )


def with_tolerances(arm: RealArm, rng: np.random.Generator) -> RealArm:
    """The arm with manufacturing tolerances: normal, of the standard deviations of this module.

    The holes of one cable share their error, as those of a drilling template do.
    """
    body, cables = arm.body, arm.body.cable_count
    masses = body.mass_kg * (1.0 + _MASS_SHARE * rng.standard_normal(len(body.mass_kg)))
    contact = body.contact_at_m.copy()
    contact[:, 0] += _CONTACT_M * rng.standard_normal(len(contact))
    pretension = body.pretension_n + _PRETENSION_N * rng.standard_normal(cables)
    by_rad = np.deg2rad(_HOLE_DEG) * rng.standard_normal(cables)
    zeros = arm.sensing.offset_n + _ZERO_N * rng.standard_normal(cables)
    body = replace(
        body,
        mass_kg=masses,
        pretension_n=pretension,
        contact_at_m=contact,
        before_m=turned(body.before_m, by_rad),
        after_m=turned(body.after_m, by_rad),
    )
    return replace(arm, body=body, sensing=replace(arm.sensing, offset_n=zeros))


def turned(points_m: Array, by_rad: Array) -> Array:
    """Points (..., 3) turned about x, from +z towards +y."""
    sine, cosine = np.sin(by_rad), np.cos(by_rad)
    x, y, z = np.moveaxis(points_m, -1, 0)
    return np.stack([x, cosine * y + sine * z, cosine * z - sine * y], axis=-1)
