"""An arm with whatever is wrong with it, and the noise-free readings of its sensors."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from cablesense_base import Array
from cablesense_plants.arm.body import NONE, Body, Creep, Nominal, PlantFriction, rigid_body
from cablesense_plants.arm.geometry import cable_lengths_m
from cablesense_plants.arm.protocol import Schedule
from cablesense_plants.arm.quasi_static import QuasiStaticPath
from cablesense_plants.arm.rest import follow_path
from cablesense_plants.arm.sensing import SensorFaults

_MASS_SHARE, _PRETENSION_N, _CONTACT_M, _HOLE_DEG, _ZERO_N = 0.005, 0.15, 0.0003, 0.05, 0.05
"""Standard deviations of manufacturing."""


@dataclass(frozen=True)
class ActuatorFaults:
    """Faults of M actuators; by default they follow the command exactly.

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
    sensing: SensorFaults
    load_turn: Array
    actuation: ActuatorFaults = ActuatorFaults()
    friction: PlantFriction = field(default_factory=PlantFriction)
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
        paid_out = self.actuation.paid_out_m(self.held_m(command), time_s)
        if self.history_dependent:
            tension = self._path_tensions_n(command, paid_out, loads, time_s)
        else:
            tension = follow_path(self.body, command, paid_out, loads).tensions_n
        return self.sensing.signals_n(np.maximum(tension[before:], 0.0), schedule.time_s)

    def held_m(self, command_rad: Array) -> Array:
        """(R, M) cable paid out by commands (R, 2N) as drawn, minus that of the straight arm."""
        drawn = rigid_body(self.nominal)
        straight = cable_lengths_m(drawn, np.zeros((1, command_rad.shape[1])))
        return cable_lengths_m(drawn, command_rad) - straight

    def _path_tensions_n(
        self, command: Array, paid_out: Array, loads: Array, time_s: Array
    ) -> Array:
        stepped = SteppedArms(self, command[:1], paid_out[:1], loads[:1])
        tension = np.empty_like(paid_out)
        tension[0] = stepped.tensions_n[0]
        friction = self.friction
        timeless = not self.creep.compliance_m_n.any() and friction.joint_breakaway == 1.0
        for row in range(1, len(tension)):
            still = np.array_equal(paid_out[row], paid_out[row - 1])
            if not (timeless and still and np.array_equal(loads[row], loads[row - 1])):
                period_s = float(time_s[row] - time_s[row - 1])
                stepped.step(paid_out[row, None], loads[row, None], period_s)
            tension[row] = stepped.tensions_n[0]
        return tension


class SteppedArms:
    """B arms with the same friction and creep side by side, moved from rest to rest."""

    def __init__(self, arm: RealArm, command_rad: Array, held_m: Array, forces_n: Array) -> None:
        """Rests before any sliding, at commands (B, 2N), and as `step` has the others."""
        self._path = QuasiStaticPath(arm.body, arm.friction, arm.creep, arm.nominal.run_m)
        self._state = self._path.start(command_rad, held_m, forces_n)

    def step(self, held_m: Array, forces_n: Array, period_s: float = 1.0) -> Array:
        """Tensions at the actuators, N (B, M), at the next rests.

        Args:
            held_m: (B, M) cable that the actuators have paid out, less that of the straight arm:
                `RealArm.held_m` of the commands, and offsets.
            forces_n: (B, N, 3) at the segments' contact points, in base axes.
            period_s: since the last rests, for creep and what depends on the joints' speed.

        Raises:
            PlantError: an arm has no rest; all stay where they were.
        """
        self._state = self._path.advance(self._state, held_m, forces_n, period_s)
        return self.tensions_n

    @property
    def tensions_n(self) -> Array:
        """(B, M) at the actuators, noise-free; 0 where a cable is slack."""
        return np.maximum(self._state.tension_n[..., 0], 0.0)

    @property
    def angles_rad(self) -> Array:
        """(B, 2J) at which the joints rest."""
        return self._state.angles_rad


def ideal_arm(nominal: Nominal) -> RealArm:
    """The arm exactly as drawn."""
    return RealArm(nominal, rigid_body(nominal), SensorFaults(nominal.pretension_n), np.eye(3))


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
