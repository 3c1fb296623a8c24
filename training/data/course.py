"""Samples on an arm with effects: each through a short course of its own, so that the past shows.

An arm without effects has no past, and its samples are rests. One with friction or creep reads
what its history left. So every sample begins at another pose, goes to its command, where the tare
is taken, and is pushed there: up to its force, or for half of them beyond it and back. What the
times of the course are is drawn once for a block of samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablesense_sim.effects.chains import actuations, amended, memories, sensings
from cablesense_sim.effects.entry import EffectEntry
from cablesense_sim.equilibrium import EquilibriumError, held_lengths_m, solve_equilibrium
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.quasi_static import QuasiStaticArm
from cablesense_training.data.rest import TooManyFailures

Array = NDArray[np.float64]

_ON_THE_WAY = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Shares of the way to the command, at which the arm comes to rest."""

_RISE = (0.2, 0.4, 0.6, 0.8, 1.0)
"""Shares of the highest force on the way up."""

_BACK = (0.5, 1.0, 1.0)
"""Shares of the way from there to the sample's force; the last is where it is read."""

_TARED = len(_ON_THE_WAY) - 1
_STEP_S = 0.5
_LONGEST_WAIT_S = 30.0
_LONGEST_HOLD_S = 5.0
_HIGHEST_PEAK = 1.4


@dataclass(frozen=True)
class Course:
    """What B samples go through in R rests.

    Attributes:
        time_s: (R,) of the rests.
        from_share: (B,) the pose at the start is that share of the command, from -1 to 1.
        peak_share: (B,) the highest force on the way is that share of the sample's, from 1 up.
    """

    time_s: Array
    from_share: Array
    peak_share: Array

    @classmethod
    def drawn(cls, count: int, rng: np.random.Generator) -> Course:
        """A course for `count` samples."""
        steps = np.full(len(_ON_THE_WAY) + len(_RISE) + len(_BACK), _STEP_S)
        steps[_TARED] += rng.uniform(0.0, _LONGEST_WAIT_S)
        steps[_TARED + 1] += rng.uniform(0.0, _LONGEST_WAIT_S)
        steps[-1] = rng.uniform(0.0, _LONGEST_HOLD_S)
        beyond = rng.random(count) < 0.5
        peak = np.where(beyond, rng.uniform(1.0, _HIGHEST_PEAK, count), 1.0)
        return cls(np.cumsum(steps), rng.uniform(-1.0, 1.0, count), peak)

    def select(self, rows: NDArray[np.int64]) -> Course:
        """The same for some of the samples."""
        return Course(self.time_s, self.from_share[rows], self.peak_share[rows])

    def commands_rad(self, command_rad: Array) -> Array:
        """(R, B, 2N) for the samples' commands (B, 2N)."""
        way = np.concatenate([_ON_THE_WAY, np.ones(len(_RISE) + len(_BACK))])
        share = self.from_share + way[:, None] * (1.0 - self.from_share)
        return share[..., None] * command_rad

    def loads_n(self, forces_n: Array) -> Array:
        """(R, B, N, 3) for the samples' loads (B, N, 3)."""
        none = np.zeros((len(_ON_THE_WAY), len(forces_n)))
        rise = np.array(_RISE)[:, None] * self.peak_share
        back = self.peak_share + np.array(_BACK)[:, None] * (1.0 - self.peak_share)
        share = np.concatenate([none, rise, back])
        return share[..., None, None] * forces_n


def course_readings_n(
    nominal: Mechanism,
    entries: list[EffectEntry],
    course: Course,
    command_rad: Array,
    forces_n: Array,
    allowed_failures: int,
) -> tuple[Array, Array, Array]:
    """Loaded and unloaded readings without noise, and loaded tensions, each (B, M).

    NaN in rows that find no rest somewhere on their course.

    Raises:
        TooManyFailures: more rows than allowed find none.
    """
    found = np.full((3, len(command_rad), nominal.cable_count), np.nan)
    rows = np.arange(len(command_rad))
    while rows.size:
        try:
            tensions = _tensions_n(
                nominal, entries, course.select(rows), command_rad[rows], forces_n[rows]
            )
        except EquilibriumError as error:
            allowed_failures -= error.failed.size
            if not error.failed.size or allowed_failures < 0:
                raise TooManyFailures(str(error)) from error
            rows = np.delete(rows, error.failed)
            continue
        readings = tensions
        for sensing in sensings([entries] * len(rows)):
            read = [sensing.step(t, readings[r]) for r, t in enumerate(course.time_s)]
            readings = np.stack(read)
        found[:, rows] = readings[-1], readings[_TARED], tensions[-1]
        break
    return found[0], found[1], found[2]


def _tensions_n(
    nominal: Mechanism,
    entries: list[EffectEntry],
    course: Course,
    command_rad: Array,
    forces_n: Array,
) -> Array:
    """True tensions (R, B, M) along the course; zero where no one looks and nothing remembers."""
    commands, loads = course.commands_rad(command_rad), course.loads_n(forces_n)
    held = held_lengths_m(nominal, commands)
    arms = [entries] * len(command_rad)
    for actuation in actuations(arms):
        for row, time in enumerate(course.time_s):
            held[row] = actuation.step(time, held[row])
    mechanism = amended(nominal, entries)
    if memories(arms):
        arm = QuasiStaticArm([mechanism] * len(arms), arms)
        return np.stack([arm.step(t, held[r], loads[r]) for r, t in enumerate(course.time_s)])
    read = range(len(held)) if sensings(arms) else (_TARED, len(held) - 1)
    tensions = np.zeros_like(held)
    for row in read:
        rest = solve_equilibrium(mechanism, commands[row], loads[row], held_m=held[row])
        tensions[row] = rest.tensions_n
    return tensions
