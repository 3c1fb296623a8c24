"""An arm with whatever is wrong with it, the noise-free readings of its sensors, and its changes.

A change is one thing that is wrong, in one physical form, at a place, of a size. What it does to
the arm is data: which fields of which part it sets, and how its size enters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from cablesense_base.arrays import Array
from cablesense_gap.plant.body import (
    Body,
    Creep,
    Friction,
    Nominal,
    no_creep,
    no_friction,
    rigid_body,
)
from cablesense_gap.plant.geometry import cable_lengths_m
from cablesense_gap.plant.protocol import Schedule
from cablesense_gap.plant.quasi_static import QuasiStaticPath
from cablesense_gap.plant.rest import follow_path
from cablesense_gap.plant.sensing import Sensing, ideal_sensing

UNKNOWN = "unknown"
_MASS_SHARE, _PRETENSION_N, _CONTACT_M, _HOLE_DEG, _ZERO_N = 0.005, 0.15, 0.0003, 0.05, 0.05
"""Standard deviations of manufacturing."""


@dataclass(frozen=True)
class Actuation:
    """Faults of M actuators.

    Attributes:
        play_m: (M,) lost motion on reversal, from end to end.
        play_start: (M,) where in the play each begins, -1 to 1.
        ratio: (M,) metres paid out for one that is commanded.
        screw_m: (M,) amplitude of an error periodic in the length.
        screw_phase_rad: (M,) its phase at the straight arm.
        slip_m: (M,) length that each clamp lets through at `slip_time_s`.
        screw_pitch_m: period of the screws' error.
    """

    play_m: Array
    play_start: Array
    ratio: Array
    screw_m: Array
    screw_phase_rad: Array
    slip_m: Array
    screw_pitch_m: float = 0.004
    slip_time_s: float = np.inf

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
    return Actuation(zero, zero, zero + 1.0, zero, zero, zero)


@dataclass(frozen=True)
class RealArm:
    """An arm with whatever is wrong with it.

    Attributes:
        nominal: the arm as drawn, by which its actuators are commanded.
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
    body, cables = rigid_body(nominal), nominal.cable_count
    free = ideal_actuation(cables), no_friction(body), no_creep(body)
    return RealArm(nominal, body, *free, ideal_sensing(cables, nominal.pretension_n), np.eye(3))


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


Draw = Callable[[np.random.Generator, Nominal], "Change"]
"""Draws the form and the place of a change; its size comes later."""

Apply = Callable[[RealArm, float], RealArm]
"""Gives the arm with a change of a size; cases go to other processes, so it can be pickled."""


@dataclass(frozen=True)
class Change:
    """What is wrong, but for how much.

    Attributes:
        effect: its name in verdicts, `unknown` outside the list.
        form: what it physically is.
        unit: of its size.
        least: smallest size that is worth drawing.
        most: largest size that an arm would still be used with.
        apply: gives the arm that has it, by size.
        where: places (`cable_3`, `segment_2`, `joint_1`); none for the whole arm.
        details: what else was drawn, for the answers.
    """

    effect: str
    form: str
    unit: str
    least: float
    most: float
    apply: Apply
    where: tuple[str, ...] = ()
    details: Mapping[str, float] = field(default_factory=dict)


def sets(part: str, **fields: Any) -> Apply:
    """Sets fields of a part of the arm (`body` …), each to a value, or as a tuple has it.

    A tuple is a law, as `scaled`, and what it takes beside the field's old value and the size.
    """
    return partial(_with_fields, part=part, fields=fields)


def _with_fields(arm: RealArm, size: float, part: str, fields: Mapping[str, Any]) -> RealArm:
    whole = getattr(arm, part)
    new = {
        name: value[0](getattr(whole, name), size, *value[1:]) if type(value) is tuple else value
        for name, value in fields.items()
    }
    return replace(arm, **{part: replace(whole, **new)})


def scaled(_old: Any, size: float, share: Any) -> Any:
    """A share of the size."""
    return size * share


def added(old: Any, size: float, share: Any) -> Any:
    """A share of the size added."""
    return old + size * share


def grown(old: Any, size: float, share: Any) -> Any:
    """The old value times 1 and a share of the size."""
    return old * (1.0 + size * share)


def sized(old: Any, size: float, value: Any, name: str) -> Any:
    """A value, or a tuple of one where there was a tuple, with one field times the size."""
    new = replace(value, **{name: size * getattr(value, name)})
    return (new,) if isinstance(old, tuple) else new


def some(rng: np.random.Generator, count: int, least: int, most: int) -> list[int]:
    """Between `least` and `most` of the positions below `count`, ascending."""
    number = int(rng.integers(least, min(most, count) + 1))
    return sorted(int(i) for i in rng.choice(count, number, replace=False))


def places(kind: str, positions: Sequence[int], count: int) -> tuple[str, ...]:
    """Names of positions counted from 0; none where they are all."""
    return () if len(positions) == count else tuple(f"{kind}_{i + 1}" for i in positions)


def weights(
    rng: np.random.Generator, positions: list[int], count: int, signed: bool = False
) -> Array:
    """(count,) of 0, and of numbers between 0.5 and 1 at the positions; one is 1 or -1."""
    result = np.zeros(count)
    drawn = rng.uniform(0.5, 1.0, len(positions))
    drawn /= drawn.max()
    result[positions] = drawn * rng.choice([-1.0, 1.0], len(drawn)) if signed else drawn
    return result


def marked(positions: Any, count: int, value: float = 1.0) -> Array:
    """(count,) of 0, and of a value at the positions."""
    result = np.zeros(count)
    result[positions] = value
    return result
