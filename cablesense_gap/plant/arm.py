"""A whole arm as it stands in a workshop, and what its sensors would say without noise.

What actuators make of commanded lengths: play, wrong ratios, uneven screws, slipping clamps.

What a careful workshop leaves: no two arms are exactly alike.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cablesense_base.arrays import Array
from cablesense_gap.plant.body import Body, Nominal, stiff_body
from cablesense_gap.plant.geometry import cable_lengths_m
from cablesense_gap.plant.march import March
from cablesense_gap.plant.protocol import Schedule
from cablesense_gap.plant.rest import follow
from cablesense_gap.plant.rubbing import Creep, Rubbing, firm, smooth
from cablesense_gap.plant.sensing import Sensing, ideal_sensing


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
        slip_m: (M,) what each clamp lets through at `slip_time_s`.
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
    """Actuators that do what they are told."""
    zero = np.zeros(cables)
    return Actuation(zero, zero, zero + 1.0, zero, 0.004, zero, zero, np.inf)


@dataclass(frozen=True)
class RealArm:
    """An arm with whatever is wrong with it.

    Attributes:
        nominal: the arm as drawn, by which its actuators are commanded.
        body: joints, holes, masses, cables, springs.
        actuation: what the actuators make of commands.
        rubbing: friction.
        creep: of the cables.
        sensing: what the sensors make of tensions.
        load_turn: (3, 3) from the load that is written down to the one that acts.
    """

    nominal: Nominal
    body: Body
    actuation: Actuation
    rubbing: Rubbing
    creep: Creep
    sensing: Sensing
    load_turn: Array

    @property
    def remembers(self) -> bool:
        """Whether a rest depends on those before."""
        return self.rubbing.any or self.creep.any


def ideal_arm(nominal: Nominal) -> RealArm:
    """The arm exactly as drawn."""
    body = stiff_body(nominal)
    return RealArm(
        nominal=nominal,
        body=body,
        actuation=ideal_actuation(nominal.cable_count),
        rubbing=smooth(body),
        creep=firm(body),
        sensing=ideal_sensing(nominal.cable_count, nominal.pretension_n),
        load_turn=np.eye(3),
    )


def signals_n(arm: RealArm, schedule: Schedule, history: Schedule) -> Array:
    """(R, M) noise-free readings over a schedule, after a history that nobody saw.

    Raises:
        PlantError: the arm finds no rest in some row.
    """
    before = len(history.time_s)
    command = np.concatenate([history.command_rad, schedule.command_rad])
    time_s = np.concatenate([history.time_s, schedule.time_s])
    loads = np.concatenate([history.forces_n, schedule.forces_n]) @ arm.load_turn.T
    drawn = stiff_body(arm.nominal)
    straight = cable_lengths_m(drawn, np.zeros((1, command.shape[1])))
    wanted = cable_lengths_m(drawn, command) - straight
    paid_out = arm.actuation.paid_out_m(wanted, time_s)
    if arm.remembers:
        tension = _marched_n(arm, command, paid_out, loads, time_s)
    else:
        tension = follow(arm.body, command, paid_out, loads).tensions_n
    return arm.sensing.signals_n(np.maximum(tension[before:], 0.0), schedule.time_s)


def _marched_n(
    arm: RealArm, command: Array, paid_out: Array, loads: Array, time_s: Array
) -> Array:
    march = March(arm.body, arm.rubbing, arm.creep, arm.nominal.run_m)
    state = march.start(command[0], paid_out[0], loads[0])
    tension = np.empty_like(paid_out)
    tension[0] = state.tension_n[0]
    timeless = not arm.creep.any and arm.rubbing.breakaway == 1.0
    for row in range(1, len(tension)):
        still = np.array_equal(paid_out[row], paid_out[row - 1])
        if not (timeless and still and np.array_equal(loads[row], loads[row - 1])):
            period_s = float(time_s[row] - time_s[row - 1])
            state = march.advance(state, paid_out[row], loads[row], period_s)
        tension[row] = state.tension_n[0]
    return tension


MASS_SHARE = 0.005
PRETENSION_N = 0.15
CONTACT_M = 0.0003
HOLE_DEG = 0.05
ZERO_N = 0.05


def scattered(arm: RealArm, rng: np.random.Generator) -> RealArm:
    """The arm with normal deviations of one sigma each, as the constants of this module say.

    A cable's holes share their error, as those of a drilling template do.
    """
    body, cables = arm.body, arm.body.cable_count
    masses = body.mass_kg * (1.0 + MASS_SHARE * rng.standard_normal(len(body.mass_kg)))
    contact = body.contact_at_m.copy()
    contact[:, 0] += CONTACT_M * rng.standard_normal(len(contact))
    body = replace(
        body,
        mass_kg=masses,
        pretension_n=body.pretension_n + PRETENSION_N * rng.standard_normal(cables),
        contact_at_m=contact,
    )
    turned = turned_holes(body, np.deg2rad(HOLE_DEG) * rng.standard_normal(cables))
    zeros = arm.sensing.offset_n + ZERO_N * rng.standard_normal(cables)
    return replace(arm, body=turned, sensing=replace(arm.sensing, offset_n=zeros))


def turned_holes(body: Body, by_rad: np.ndarray) -> Body:
    """The body with the holes of each cable turned about the axis by angles (M,), +z to +y."""
    return replace(
        body, before_m=turned(body.before_m, by_rad), after_m=turned(body.after_m, by_rad)
    )


def turned(points_m: np.ndarray, by_rad: np.ndarray) -> np.ndarray:
    """Points (..., 3) turned about x, from +z towards +y."""
    sine, cosine = np.sin(by_rad), np.cos(by_rad)
    x, y, z = np.moveaxis(points_m, -1, 0)
    return np.stack([x, cosine * y + sine * z, cosine * z - sine * y], axis=-1)
