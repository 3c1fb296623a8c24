"""An arm with whatever is wrong with it, and the noise-free readings of its sensors."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from cablesense_base import Array
from cablesense_gap.plant.body import NONE, Body, Creep, Friction, Nominal, rigid_body
from cablesense_gap.plant.geometry import cable_lengths_m
from cablesense_gap.plant.protocol import Schedule
from cablesense_gap.plant.quasi_static import QuasiStaticPath
from cablesense_gap.plant.rest import follow_path
from cablesense_gap.plant.sensing import Sensing

_MASS_SHARE, _PRETENSION_N, _CONTACT_M, _HOLE_DEG, _ZERO_N = 0.005, 0.15, 0.0003, 0.05, 0.05
"""Standard deviations of manufacturing."""


@dataclass(frozen=True)
class Actuation:
    """Faults of M actuators; by default they pay out exactly what is commanded.

    Attributes:
        play_m: (M,) lost motion on reversal, from end to end.
        play_start: (M,) where in the play each begins, -1 to 1.
        ratio: (M,) metres paid out for one that is commanded.
        screw_m: (M,) amplitude of an error periodic in the length.
        screw_phase_rad: (M,) its phase at the straight arm.
        slip_m: (M,) length that each clamp lets through at `slip_time_s`.
        screw_pitch_m: period of the screws' error.
    """

    play_m: Array = NONE
    play_start: Array = NONE
    ratio: Array = NONE + 1.0
    screw_m: Array = NONE
    screw_phase_rad: Array = NONE
    slip_m: Array = NONE
    screw_pitch_m: float = 0.004
    slip_time_s: float = np.inf

    def paid_out_m(self, commanded_m: Array, time_s: Array) -> Array:
        """(R, M) lengths given, of those commanded, both less that of the straight arm."""
        phase = 2.0 * np.pi * commanded_m / self.screw_pitch_m + self.screw_phase_rad
        uneven = self.screw_m * (np.sin(phase) - np.sin(self.screw_phase_rad))
        slipped = (time_s >= self.slip_time_s)[:, None] * self.slip_m
        given = self.ratio * commanded_m
        if self.play_m.any():
            half = 0.5 * self.play_m
            at = given[0] + half * self.play_start
            for row in given:
                row[:] = at = np.clip(at, row - half, row + half)
        return given + uneven + slipped


@dataclass(frozen=True)
class RealArm:
    """An arm with whatever is wrong with it.

    Attributes:
        nominal: the arm as drawn, by which its actuators are commanded.
        load_turn: (3, 3) from the load that is written down to the one that acts.
    """

    nominal: Nominal
    body: Body
    sensing: Sensing
    load_turn: Array
    actuation: Actuation = Actuation()
    friction: Friction = field(default_factory=Friction)
    creep: Creep = field(default_factory=Creep)

    @property
    def history_dependent(self) -> bool:
        """Whether a rest depends on those before."""
        friction = self.friction.coefficient.any() or self.friction.joint_nm.any()
        return bool(friction or self.creep.compliance_m_n.any())

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
        timeless = not self.creep.compliance_m_n.any() and self.friction.breakaway == 1.0
        for row in range(1, len(tension)):
            still = np.array_equal(paid_out[row], paid_out[row - 1])
            if not (timeless and still and np.array_equal(loads[row], loads[row - 1])):
                period_s = float(time_s[row] - time_s[row - 1])
                state = path.advance(state, paid_out[row], loads[row], period_s)
            tension[row] = state.tension_n[0]
        return tension


def ideal_arm(nominal: Nominal) -> RealArm:
    """The arm exactly as drawn."""
    return RealArm(nominal, rigid_body(nominal), Sensing(nominal.pretension_n), np.eye(3))


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
    before, after = turned(body.before_m, by_rad), turned(body.after_m, by_rad)
    body = replace(
        body, mass_kg=masses, pretension_n=pretension, contact_at_m=contact,
        before_m=before, after_m=after,
    )  # fmt: skip
    return replace(arm, body=body, sensing=replace(arm.sensing, offset_n=zeros))


def turned(points_m: Array, by_rad: Array) -> Array:
    """Points (..., 3) turned about x, from +z towards +y."""
    sine, cosine = np.sin(by_rad), np.cos(by_rad)
    x, y, z = np.moveaxis(points_m, -1, 0)
    return np.stack([x, cosine * y + sine * z, cosine * z - sine * y], axis=-1)
