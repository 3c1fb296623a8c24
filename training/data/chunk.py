"""One chunk of a dataset: what every worker computes, from arm, protocol, seed and chunk number.

A case can lie beyond the arm: on a compliant one, a large force at an unlucky pose bends a joint
until its guide plates meet, and no tension belongs to that. Such a case is drawn again (same
segments touched or same number of contacts, all else anew, from a random stream of its own), and
the row says how often. It is an exception, not a way of sampling: where more than
`MAX_REDRAWN_SHARE` of a chunk would need it, the protocol does not suit the arm and is refused.

An arm whose file lists effects is sampled with them, and where the protocol says so, blocks of
`BLOCK_SAMPLES` are sampled on arms with other effects each (`drawn_arm`). Where effects have come
together so unluckily that more than `MAX_FAILING_SHARE` of a block finds no rest, another arm is
drawn for it.

An arm without effects has no history, and its samples are static equilibria. One with friction or
creep reads what its history left. So every sample begins at another pose, goes to its command,
where the tare is taken, and is loaded there: up to its force, or for half of them beyond it and
back (`LoadHistory`, whose times are drawn once for a block of samples).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablesense_base.arrays import Array
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.effects.registry import (
    EffectEntry,
    actuations,
    amended,
    sensings,
    transmissions,
)
from cablesense_sim.equilibrium import EquilibriumError, held_lengths_m, solve_equilibrium
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.quasi_static import QuasiStaticArm
from cablesense_sim.replay import read_tensions_n
from cablesense_training.data.dataset import Dataset, contact_forces_n
from cablesense_training.data.protocols import (
    ARM,
    CHUNK_SAMPLES,
    NOISE,
    REDRAW,
    Protocol,
    chunk_sizes,
    drawn_entries,
    effect_names,
    random_stream,
    unit_points,
)
from cablesense_training.errors import DatasetError


class _TooManyFailures(Exception):  # noqa: N818
    """More cases without equilibrium than were allowed; the text gives one, and why."""


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
class LoadHistory:
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
    def drawn(cls, count: int, rng: np.random.Generator) -> LoadHistory:
        """A history for `count` samples."""
        steps = np.full(len(_ON_THE_WAY) + len(_RISE) + len(_BACK), _STEP_S)
        steps[_TARED] += rng.uniform(0.0, _LONGEST_WAIT_S)
        steps[_TARED + 1] += rng.uniform(0.0, _LONGEST_WAIT_S)
        steps[-1] = rng.uniform(0.0, _LONGEST_HOLD_S)
        beyond = rng.random(count) < 0.5
        peak = np.where(beyond, rng.uniform(1.0, _HIGHEST_PEAK, count), 1.0)
        return cls(np.cumsum(steps), rng.uniform(-1.0, 1.0, count), peak)

    def select(self, rows: NDArray[np.int64]) -> LoadHistory:
        """The same for some of the samples."""
        return LoadHistory(self.time_s, self.from_share[rows], self.peak_share[rows])

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


def _solved_rows(
    shape: tuple[int, ...], allowed_failures: int, solve: Callable[[NDArray[np.int64]], Array]
) -> Array:
    """What `solve` gives for rows, the last axis but one of `shape`; NaN without equilibrium.

    Raises:
        _TooManyFailures: more rows than allowed have none.
    """
    whole = np.full(shape, np.nan)
    rows = np.arange(shape[-2])
    while rows.size:
        try:
            whole[..., rows, :] = solve(rows)
        except EquilibriumError as error:
            allowed_failures -= error.failed.size
            if not error.failed.size or allowed_failures < 0:
                raise _TooManyFailures(str(error)) from error
            rows = np.delete(rows, error.failed)
            continue
        break
    return whole


def _readings_after_n(
    nominal: Mechanism,
    entries: list[EffectEntry],
    history: LoadHistory,
    command_rad: Array,
    forces_n: Array,
) -> Array:
    """(3, B, M): loaded and unloaded readings without noise, and loaded tensions."""
    tensions = _tensions_n(nominal, entries, history, command_rad, forces_n)
    readings = tensions
    for sensing in sensings([entries] * len(command_rad)):
        readings = np.stack([sensing.step(t, readings[r]) for r, t in enumerate(history.time_s)])
    return np.stack([readings[-1], readings[_TARED], tensions[-1]])


def _tensions_n(
    nominal: Mechanism,
    entries: list[EffectEntry],
    history: LoadHistory,
    command_rad: Array,
    forces_n: Array,
) -> Array:
    """True tensions (R, B, M) along the history; zero where they are not needed."""
    commands, loads = history.commands_rad(command_rad), history.loads_n(forces_n)
    held = held_lengths_m(nominal, commands)
    arms = [entries] * len(command_rad)
    for actuation in actuations(arms):
        for row, time in enumerate(history.time_s):
            held[row] = actuation.step(time, held[row])
    mechanism = amended(nominal, entries)
    if transmissions(arms):
        arm = QuasiStaticArm([mechanism] * len(arms), arms)
        return np.stack([arm.step(t, held[r], loads[r]) for r, t in enumerate(history.time_s)])
    read = range(len(held)) if sensings(arms) else (_TARED, len(held) - 1)
    tensions = np.zeros_like(held)
    for row in read:
        rest = solve_equilibrium(mechanism, commands[row], loads[row], held_m=held[row])
        tensions[row] = rest.tensions_n
    return tensions


BLOCK_SAMPLES = 64
"""How many samples of a chunk share one arm where the protocol draws arms."""

MAX_FAILING_SHARE = 0.03
"""Largest share of a block that may find no rest on the arm that is drawn for it."""

MAX_ARMS_DRAWN = 20

MAX_REDRAWN_SHARE = 0.02
"""Largest share of a chunk that may lie beyond the arm."""


def generate_chunk(arm: Arm, protocol: Protocol, seed: int, chunk: int) -> Dataset:
    """The samples of one chunk; the last chunk of a run may hold fewer than `CHUNK_SAMPLES`.

    A sample's reading is one sensor reading of the loaded arm at rest. Its tare is the mean of
    `tare_samples` readings of the unloaded arm at rest under the same command. With effects, both
    come at the end of a `LoadHistory` of their own.

    Raises:
        DatasetError: the protocol does not fit the arm.
    """
    rows = chunk_sizes(protocol.samples)[chunk]
    count = arm.segment_count
    resting = _Resting(arm, protocol, seed, chunk)
    stream = random_stream(REDRAW, seed, chunk)
    points = unit_points(protocol.dimensions(count), seed, chunk)[:rows]
    loaded, unloaded, borne = found = np.empty((3, rows, arm.cable_count))
    redrawn = np.zeros(rows, dtype=np.int64)
    share = MAX_REDRAWN_SHARE if protocol.randomise is None else 2.0 * MAX_FAILING_SHARE
    allowed = math.ceil(share * rows)
    open_rows = np.arange(rows)
    while open_rows.size:
        try:
            found[:, open_rows] = resting(points[open_rows], open_rows, allowed)
        except _TooManyFailures as error:
            raise DatasetError(
                f"samples {chunk * CHUNK_SAMPLES} and following: more than "
                f"{share:.0%} lie beyond arm {arm.identity}, for example: {error}"
            ) from error
        open_rows = np.flatnonzero(np.isnan(loaded).any(axis=1) | np.isnan(unloaded).any(axis=1))
        redrawn[open_rows] += 1
        allowed -= len(open_rows)
        points[open_rows, 1:] = stream.random((len(open_rows), points.shape[1] - 1))

    cases = protocol.cases(count, points)
    reading, tare = loaded, unloaded
    if protocol.noise:
        noise = random_stream(NOISE, seed, chunk)
        reading = read_tensions_n(loaded, arm.sensors, noise)
        tare = np.zeros_like(unloaded)
        for _ in range(protocol.tare_samples):
            tare += read_tensions_n(unloaded, arm.sensors, noise)
        tare /= protocol.tare_samples
    first = chunk * CHUNK_SAMPLES
    return Dataset(
        arm=arm,
        protocol=protocol,
        seed=seed,
        sample_id=np.arange(first, first + rows),
        command_rad=cases.command_rad,
        tension_difference_n=reading - tare,
        unloaded_n=tare,
        contacts=cases.contacts,
        angles_deg=cases.angles_deg,
        magnitudes_n=cases.magnitudes_n,
        slack_cables=(borne <= 0.0).sum(axis=1),
        redrawn=redrawn,
    )


class _Resting:
    """Samples of one chunk at rest, without noise, at points of the unit cube.

    Called with points (B, dimensions), their rows in the chunk and the number that may fail, it
    gives (3, B, M): loaded and unloaded readings and the loaded tensions; NaN without equilibrium.
    """

    def __init__(self, arm: Arm, protocol: Protocol, seed: int, chunk: int) -> None:
        self._protocol = protocol
        self._mechanism = mechanism_of(arm)
        self._listed = entries_of(arm)
        self._seed = seed, chunk
        self._arms: dict[int, tuple[list[EffectEntry], LoadHistory]] = {}

    def __call__(self, points: Array, rows: NDArray[np.int64], allowed: int) -> Array:
        cases = self._protocol.cases(self._mechanism.segment_count, points)
        command = cases.command_rad
        forces = contact_forces_n(self._mechanism, command, cases.angles_deg, cases.magnitudes_n)
        if not self._listed and self._protocol.randomise is None:
            return self._without_effects(
                command, forces, np.flatnonzero(cases.contacts.any(axis=1)), allowed
            )
        found = np.empty((3, len(points), self._mechanism.cable_count))
        blocks = rows // BLOCK_SAMPLES
        for block in np.unique(blocks):
            own = np.flatnonzero(blocks == block)
            places = rows[own] % BLOCK_SAMPLES
            found[:, own] = self._block(int(block), places, command[own], forces[own], allowed)
            allowed -= int(np.isnan(found[0, own, 0]).sum())
        return found

    def _without_effects(
        self, command: Array, forces: Array, touched: NDArray[np.int64], allowed: int
    ) -> Array:
        def at_rest(command: Array, forces: Array) -> Array:
            return _solved_rows(
                (len(command), self._mechanism.cable_count),
                allowed,
                lambda rows: (
                    solve_equilibrium(self._mechanism, command[rows], forces[rows]).tensions_n
                ),
            )

        # the straight arm has one unloaded state
        poses = command if self._protocol.pose == "random" else command[:1]
        unloaded = np.empty((len(command), self._mechanism.cable_count))
        unloaded[:] = at_rest(poses, np.zeros((len(poses), *forces.shape[1:])))
        loaded = unloaded.copy()
        loaded[touched] = at_rest(command[touched], forces[touched])
        return np.stack([loaded, unloaded, loaded])

    def _block(
        self, block: int, places: NDArray[np.int64], command: Array, forces: Array, allowed: int
    ) -> Array:
        """Some samples of a block, on the arm that was drawn for it or is now."""
        segments, cables = self._mechanism.segment_count, self._mechanism.cable_count

        def readings(allowed: int) -> Array:
            entries, whole = self._arms[block]
            history = whole.select(places)
            return _solved_rows(
                (3, len(command), cables),
                allowed,
                lambda rows: _readings_after_n(
                    self._mechanism, entries, history.select(rows), command[rows], forces[rows]
                ),
            )

        if block in self._arms:
            return readings(allowed)
        randomise = self._protocol.randomise
        most = allowed if randomise is None else math.ceil(MAX_FAILING_SHARE * len(places))
        rng = random_stream(ARM, *self._seed, block)
        for attempt in range(MAX_ARMS_DRAWN):
            history, entries = LoadHistory.drawn(BLOCK_SAMPLES, rng), list(self._listed)
            if randomise is not None:
                entries += drawn_entries(effect_names(randomise), segments, cables, rng)
            self._arms[block] = entries, history
            try:
                return readings(most)
            except _TooManyFailures:
                if randomise is None or attempt + 1 == MAX_ARMS_DRAWN:
                    raise
        raise AssertionError("a loop that returns or raises")
