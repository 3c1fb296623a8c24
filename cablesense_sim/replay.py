"""Readings of an arm under given commands and loads, and the noise of its sensors.

A memoryless arm is in equilibrium where its potential is least, sample by sample and in any order;
equal samples are solved once. With history-dependent effects the samples are solved in time order.
"""

from __future__ import annotations

import math
from collections import ChainMap
from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablesense_base import Array
from cablesense_sim.arm import Arm, Sensors
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.course import Course
from cablesense_sim.effects.effect import Actuation, Sensing
from cablesense_sim.effects.registry import (
    EffectEntry,
    Variants,
    actuations,
    amended,
    joint_zeros_rad,
    loadings,
    sensings,
    transmissions,
)
from cablesense_sim.equilibrium import (
    Equilibrium,
    EquilibriumError,
    held_lengths_m,
    solve_equilibrium,
)
from cablesense_sim.equilibrium_response import EquilibriumResponse
from cablesense_sim.mechanism import Mechanism

_HARMONICS = 100
"""Terms of the series of rounding. What the others would add is below 1 % of step² / 12."""
_ARMS_KEPT = 4  # arms whose tensions are kept: the next ones often differ in their sensors alone
_FADED_N = 2e-4  # change of a tension that counts as none: equilibria are balanced to some 1e-5 N


class _EquilibriumPath(NamedTuple):
    """One history-dependent arm from equilibrium to equilibrium."""

    tensions_n: Array  # (R, M)
    turn_rad: Array  # (R, 2N) from the equilibrium before


class Replay:
    """One sequence of commands and loads that any number of arms are put through.

    Attributes:
        course: as recorded, R samples.
        group_of_row: (R,) from 0, a number that rows with the same command and loads share: a
            memoryless arm is solved in the first row of each group alone.
        equilibrium_rad: (R, 2N) joint angles at the equilibria that were found last, without
            memory of the past; the commands before any was.
    """

    def __init__(self, nominal: Arm, course: Course) -> None:
        """The actuators hold the cable lengths that the `nominal` arm has at the commands.

        Loads of which no place is stated act at the nominal `contact_m`. An effect that moves
        contact points moves the loads by as much, wherever they act.
        """
        self.course = course
        self._nominal = mechanism_of(nominal)
        self._held_m = held_lengths_m(self._nominal, course.command_rad)
        each_row = [course.command_rad, course.forces_n.reshape(len(course.forces_n), -1)]
        self._beyond_m: Array | None = None
        if course.places_m is not None:
            self._beyond_m = np.nan_to_num(course.places_m - self._nominal.contact_m, nan=0.0)
            each_row.append(self._beyond_m)
        flat = np.concatenate(each_row, axis=1)
        _, self._first_rows, self.group_of_row = np.unique(
            flat, axis=0, return_index=True, return_inverse=True
        )
        self._start_rad: Array | None = None
        self.equilibrium_rad = course.command_rad
        self._latest: dict[tuple[object, ...], Array] = {}
        self._paths: dict[tuple[object, ...], _EquilibriumPath] = {}

    def readings_n(self, variants: Variants, unborne_n: Array | None = None) -> Array:
        """Readings (P, R, M) of P arms, which have the same effects with other numbers.

        Where `unborne_n` (R, M) is given, it gives the tensions of samples that a memoryless arm
        cannot bear; one that is history-dependent reads NaN from there on.

        Raises:
            EquilibriumError: an arm finds no equilibrium.
        """
        if not transmissions(variants):
            return self._through(sensings(variants), self._memoryless_n(variants, unborne_n))
        tensions = self._in_turn_n(variants, some_may_fail=unborne_n is not None)
        return self._through(sensings(variants), tensions)

    def small_changes_n(self, base: Sequence[EffectEntry], variants: Variants) -> Array:
        """Changes (P, R, M) of the readings by P small differences from a memoryless arm.

        To first order. The variants have the same effects as the base, with other numbers.

        Raises:
            EquilibriumError: the base finds no equilibrium.
        """
        together = [base, *variants]
        mechanisms, held_m, forces_n = self._with_effects(together)
        first_rows = self._first_rows
        groups = self.group_of_row
        if not np.array_equal(held_m, held_m[:, first_rows][:, groups]):
            first_rows = np.arange(len(self.course.time_s))
            groups = first_rows
        equilibrium = self._equilibrium(mechanisms[0], first_rows, held_m[0], forces_n[0])
        loaded = [self._loaded_in_rows(mechanism, first_rows) for mechanism in mechanisms]
        loads_n = forces_n[:, first_rows]
        response = EquilibriumResponse(
            loaded[0], equilibrium.joint_angles_rad, equilibrium.tensions_n, loads_n[0]
        )
        tensions_n = [
            response.tensions_n(mechanism, held, loads)
            for mechanism, held, loads in zip(loaded, held_m[:, first_rows], loads_n, strict=True)
        ]
        readings_n = self._through(sensings(together), np.stack(tensions_n)[:, groups])
        return readings_n[1:] - readings_n[0]

    def searching_from(self, start_rad: Array) -> Replay:
        """The same, but the search for each row's rest begins at joint angles (R, 2N).

        Each row is then searched by itself, as a group has no angles of its own.
        """
        other = copy(self)
        other._start_rad = start_rad
        other.equilibrium_rad = start_rad
        other._latest = {}
        other._first_rows = np.arange(len(start_rad))
        other.group_of_row = other._first_rows
        return other

    def _in_turn_n(self, variants: Variants, *, some_may_fail: bool) -> Array:
        """Tensions (P, R, M) of history-dependent arms.

        The first is simulated alone; the others, mostly with similar numbers, are expected to turn
        as it does. Those that differ from it in fading numbers alone, as in the friction state of
        one cable, are simulated only up to the row r after which all these numbers at once no
        longer change a tension:

            r = last row with max |T(all at once) - T(first)| >= `_FADED_N`, over the cables.
        """
        first, *others = variants
        path = self._path(first, some_may_fail=some_may_fail)
        tensions = np.repeat(path.tensions_n[None], len(variants), axis=0)
        fading_changes = [self._fading_changes(first, each) for each in others]
        is_fading = np.array([bool(changes) for changes in fading_changes], dtype=bool)
        if is_fading.sum() < 2:
            is_fading[:] = False
        whole_arms = [each for each, fades in zip(others, is_fading, strict=True) if not fades]
        if not is_fading.any():
            tensions[1:] = self._path_tensions_n(whole_arms, path, some_may_fail=some_may_fail)
            return tensions
        all_at_once = [
            replace(
                entry, values=dict(ChainMap(*(c[k] for c in fading_changes if c), entry.values))
            )
            for k, entry in enumerate(first)
        ]
        whole_n = self._path_tensions_n(
            [*whole_arms, all_at_once], path, some_may_fail=some_may_fail
        )
        tensions[1:][~is_fading] = whole_n[:-1]
        differs = ~(np.abs(whole_n[-1] - path.tensions_n).max(axis=1) < _FADED_N)
        row_count = int(np.flatnonzero(differs).max(initial=-1)) + 1
        fading_arms = [each for each, fades in zip(others, is_fading, strict=True) if fades]
        first_rows = _EquilibriumPath(*(each[:row_count] for each in path))
        tensions[1:][is_fading, :row_count] = self._path_tensions_n(
            fading_arms, first_rows, some_may_fail=some_may_fail
        )
        return tensions

    def _fading_changes(
        self, first: Sequence[EffectEntry], other: Sequence[EffectEntry]
    ) -> list[dict[str, float]]:
        """The numbers of each entry that differ from the first's; none unless all of them fade."""
        sizes = self._nominal.segment_count, self._nominal.cable_count
        all_changes = []
        for before, after in zip(first, other, strict=True):
            changes = {n: v for n, v in after.values.items() if v != before.values[n]}
            parameters = (*after.effect.parameters, *after.effect.history(*sizes))
            if not changes.keys() <= {p.name for p in parameters if p.fades}:
                return []
            all_changes.append(changes)
        return all_changes if any(all_changes) else []

    def _path(self, entries: Sequence[EffectEntry], *, some_may_fail: bool) -> _EquilibriumPath:
        """The equilibria of one arm, found again if it is one of the last few."""
        key = some_may_fail, *_key(entries)
        path = self._paths.get(key)
        if path is None:
            rests = self._equilibria([entries], None, some_may_fail=some_may_fail)
            tensions, angles = (np.stack(each, axis=1)[0] for each in zip(*rests, strict=True))
            path = _EquilibriumPath(tensions, np.diff(angles, axis=0, prepend=angles[:1]))
        self._paths = dict(list({**self._paths, key: path}.items())[-_ARMS_KEPT:])
        return path

    def _path_tensions_n(
        self, variants: Variants, along: _EquilibriumPath, *, some_may_fail: bool
    ) -> Array:
        """Tensions (P, rows, M), with turns like those of another arm."""
        tensions_n = np.empty((len(variants), *along.tensions_n.shape))
        if variants:
            rests = self._equilibria(variants, along.turn_rad, some_may_fail=some_may_fail)
            for row, (tensions, _) in enumerate(rests):
                tensions_n[:, row] = tensions
        return tensions_n

    def _equilibria(
        self, variants: Variants, turn_rad: Array | None, *, some_may_fail: bool
    ) -> Iterator[tuple[Array, Array]]:
        """Tensions (P, M) and joint angles (P, 2N) at one equilibrium after another.

        With expected turns (rows, 2N) there are as many equilibria.
        """
        from cablesense_sim.quasi_static import QuasiStaticArm  # compiled: others need not wait

        mechanisms, held, forces = self._with_effects(variants)
        arm = QuasiStaticArm(mechanisms, variants, some_may_fail=some_may_fail)
        places = np.stack([mechanism.contact_m for mechanism in mechanisms])
        beyond = np.zeros((len(self.course.time_s), 1, 1))
        if self._beyond_m is not None:
            beyond = self._beyond_m[:, None]
        turns = [None] * len(self.course.time_s) if turn_rad is None else turn_rad
        for row, turn in enumerate(turns):
            loads = forces[:, row], places + beyond[row]
            yield (
                arm.step(self.course.time_s[row], held[:, row], *loads, turn),
                arm.joint_angles_rad,
            )

    def _memoryless_n(self, variants: Variants, unborne_n: Array | None) -> Array:
        """Tensions (P, R, M); arms that differ in their sensors alone are solved once."""
        of_arm = [[e for e in v if e.effect.acts_on != "sensor"] for v in variants]
        keys = [(unborne_n is None, *_key(entries)) for entries in of_arm]
        new = {
            key: entries
            for key, entries in zip(keys, of_arm, strict=True)
            if key not in self._latest
        }
        known = {key: self._latest[key] for key in keys if key in self._latest}
        if new:
            with_effects = self._with_effects(list(new.values()))
            for key, mechanism, held_m, forces_n in zip(new, *with_effects, strict=True):
                known[key] = self._at_rest_n(mechanism, held_m, forces_n, unborne_n)
        self._latest = dict(list({**self._latest, **known}.items())[-_ARMS_KEPT:])
        return np.stack([known[key] for key in keys])

    def _with_effects(self, variants: Variants) -> tuple[list[Mechanism], Array, Array]:
        """P arms as their effects make them: how they are built, driven and loaded.

        They are their mechanisms, the lengths (P, R, M) that their actuators hold, m, and the
        loads (P, R, N, 3) that act on them, N.
        """
        zeros_rad = joint_zeros_rad(variants, self._nominal.segment_count)
        if zeros_rad is None:
            held = np.repeat(self._held_m[None], len(variants), axis=0)
        else:
            each_rad, row_of_arm = np.unique(zeros_rad, axis=0, return_inverse=True)
            held = held_lengths_m(self._nominal, self.course.command_rad + each_rad[:, None])[
                row_of_arm
            ]
        forces = np.broadcast_to(
            self.course.forces_n, (len(variants), *self.course.forces_n.shape)
        )
        for matrix in loadings(variants):
            forces = forces @ matrix.swapaxes(1, 2)[:, None]
        return (
            [amended(self._nominal, entries) for entries in variants],
            self._through(actuations(variants), held),
            forces,
        )

    def _through(self, chain: Sequence[Actuation | Sensing], values: Array) -> Array:
        """Values (P, R, M) after actuators or sensors have acted on them in turn."""
        for stage in chain:
            values = stage.along(self.course.time_s, values)
        return values

    def _at_rest_n(
        self, mechanism: Mechanism, held_m: Array, forces_n: Array, unborne_n: Array | None
    ) -> Array:
        """Tensions (R, M); rows with equal command and loads are solved once."""
        first_rows = self._first_rows
        groups = self.group_of_row
        if not np.array_equal(held_m, held_m[first_rows][groups]):
            first_rows = np.arange(len(held_m))
            groups = first_rows
        borne = np.ones(len(first_rows), dtype=bool)
        try:
            equilibrium = self._equilibrium(mechanism, first_rows, held_m, forces_n)
        except EquilibriumError as error:
            if unborne_n is None or not error.failed.size:
                raise
            borne[error.failed] = False
            equilibrium = self._equilibrium(mechanism, first_rows[borne], held_m, forces_n)
        tensions = np.empty((len(first_rows), mechanism.cable_count))
        tensions[borne] = equilibrium.tensions_n
        if unborne_n is not None:
            tensions[~borne] = unborne_n[first_rows][~borne]
        angles_rad = self.course.command_rad[first_rows]
        angles_rad[borne] = equilibrium.joint_angles_rad
        self.equilibrium_rad = angles_rad[groups]
        if self._start_rad is None:
            self._start_rad = self.equilibrium_rad
        return np.asarray(tensions[groups])

    def _equilibrium(
        self, mechanism: Mechanism, rows: NDArray[np.int64], held_m: Array, forces_n: Array
    ) -> Equilibrium:
        start = self.course.command_rad if self._start_rad is None else self._start_rad
        return solve_equilibrium(
            self._loaded_in_rows(mechanism, rows),
            self.course.command_rad[rows],
            forces_n[rows],
            held_m=held_m[rows],
            start_rad=start[rows],
        )

    def _loaded_in_rows(self, mechanism: Mechanism, rows: NDArray[np.int64]) -> Mechanism:
        """The mechanism whose `contact_m` (K, N) is where the loads of K `rows` act on it.

        Where the course states no places it stays (N,), as the mechanism has it.
        """
        if self._beyond_m is None:
            return mechanism
        return replace(mechanism, contact_m=mechanism.contact_m + self._beyond_m[rows])


def _key(entries: Sequence[EffectEntry]) -> Iterator[tuple[object, ...]]:
    """The key of an arm with such entries, the same for equal arms."""
    return ((e.effect.name, e.place, *e.values.items()) for e in entries)


def replay_arm(arm: Arm, course: Course) -> Array:
    """Readings (R, M) of an arm with the effects that its file lists, over a course of R samples.

    Its actuators hold the lengths of the arm without them, as its controller knows no better.

    Raises:
        EquilibriumError: the arm finds no equilibrium.
    """
    return Replay(arm, course).readings_n([entries_of(arm)])[0]


def read_tensions_n(tensions_n: ArrayLike, sensors: Sensors, rng: np.random.Generator) -> Array:
    """Readings of tensions of any shape, N: noise, rounding to the step, held to the range."""
    reading = np.asarray(tensions_n, dtype=float)
    if sensors.noise_std_n > 0.0:
        reading = reading + rng.normal(0.0, sensors.noise_std_n, reading.shape)
    if sensors.step_n > 0.0:
        reading = np.round(reading / sensors.step_n) * sensors.step_n
    if sensors.range_n is not None:
        reading = np.clip(reading, *sensors.range_n)
    return reading


def reading_variance_n2(sensors: Sensors) -> float:
    """Variance of one reading, N²: noise, and rounding uniform over one step (step² / 12)."""
    return sensors.noise_std_n**2 + sensors.step_n**2 / 12.0


@cache
def mean_variance_n2(sensors: Sensors, count: int) -> float:
    """Variance of the mean of `count` readings of one tension, N².

    Rounding averages out only as far as noise spreads the readings over steps: the mean of all
    rounded readings is off by a Fourier series in the tension's place between two steps.
    """
    variance = reading_variance_n2(sensors)
    lasting = 0.0
    if sensors.step_n > 0.0:
        wave = math.pi * np.arange(1.0, 1.0 + _HARMONICS) / sensors.step_n
        sizes_n = np.exp(-2.0 * (wave * sensors.noise_std_n) ** 2) / wave
        lasting = 0.5 * float(sizes_n @ sizes_n)
    return lasting + (variance - lasting) / count


def difference_variance_n2(sensors: Sensors, tare_samples: int) -> float:
    """Variance of a reading minus the mean of `tare_samples` unloaded ones, N²."""
    return reading_variance_n2(sensors) * (1.0 + 1.0 / tare_samples)
