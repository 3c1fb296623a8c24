"""Generation of a dataset: in this process, on worker processes, or on a Dask cluster.

A chunk follows from arm, protocol, seed and its number, wherever it is computed (processor types
may differ in the last bit). A case beyond the arm is drawn again, and a protocol that would
need that often is refused. An arm with effects is sampled along a `LoadHistory`; randomised arms
in blocks of samples on one arm each.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_base.workers import WorkerPool
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
from cablesense_sim.replay import read_tensions_n
from cablesense_training.cluster import IN_FLIGHT_PER_WORKER, map_on_cluster
from cablesense_training.data.dataset import Dataset, contact_forces_n
from cablesense_training.data.protocols import (
    ARM,
    CHUNK_SAMPLES,
    NOISE,
    REDRAW,
    Cases,
    Protocol,
    chunk_sizes,
    drawn_entries,
    effect_names,
    random_stream,
    unit_points,
)
from cablesense_training.errors import DatasetError


def generate(
    arm: Arm, protocol: Protocol, seed: int, *, workers: int = 1, dask_scheduler: str | None = None
) -> Iterator[Dataset]:
    """The dataset in parts, in order: the same parts for any `workers` and for a Dask cluster.

    A script that asks for several workers needs the usual `if __name__ == "__main__":` guard, as
    processes are spawned. Few chunks are held at a time, so a run of any size can be written.

    Raises:
        DatasetError: an option out of range, a sample without equilibrium, a lost worker, a
            cluster out of reach or one that runs another version of this package.
    """
    for name, value, least, most in (("seed", seed, 0, 2**63 - 1), ("workers", workers, 1, 256)):
        if not isinstance(value, int) or not least <= value <= most:
            raise DatasetError(f"{name} = {value!r}: must be a whole number, {least} to {most}")
    chunks = len(chunk_sizes(protocol.samples))
    if dask_scheduler is not None:
        tasks = generate_chunk, range(chunks), arm, protocol, seed
        return map_on_cluster(dask_scheduler, *tasks, refusal=DatasetError)
    return _on_processes(min(workers, chunks), chunks, arm, protocol, seed)


def draw_dataset(arm: Arm, protocol: Protocol, seed: int = 0, *, workers: int = 1) -> Dataset:
    """The dataset that arm, protocol and seed determine, in memory.

    Raises:
        DatasetError: as `generate`.
    """
    return Dataset.concatenate(list(generate(arm, protocol, seed, workers=workers)))


def _on_processes(workers: int, chunks: int, *run: Any) -> Iterator[Dataset]:
    with WorkerPool(workers, *run, refusal=DatasetError) as pool:
        most_pending = workers * IN_FLIGHT_PER_WORKER
        yield from pool.map(generate_chunk, range(chunks), most_pending=most_pending)


_BLOCK_SAMPLES = 64
"""How many samples of a chunk share one arm where the protocol draws arms."""

_MAX_FAILING_SHARE = 0.03
"""Largest share of a block that may find no rest on the arm that is drawn for it."""

_MAX_ARMS_DRAWN = 20
"""Arms with drawn effects that are tried for a block of samples until one bears its loads."""

_MAX_REDRAWN_SHARE = 0.02
"""Largest share of a chunk that may lie beyond the arm."""


def generate_chunk(arm: Arm, protocol: Protocol, seed: int, chunk: int) -> Dataset:
    """The samples of one chunk; the last chunk of a run may hold fewer than `CHUNK_SAMPLES`.

    A sample's reading is one of the loaded arm at rest, its tare the mean of `tare_samples` of the
    unloaded arm at the same command. With effects, both come at the end of a `LoadHistory`.

    Raises:
        DatasetError: the protocol does not fit the arm.
    """
    rows = chunk_sizes(protocol.samples)[chunk]
    count = arm.segment_count
    resting = _Resting(arm, protocol, seed, chunk)
    stream = random_stream(REDRAW, seed, chunk)
    points = unit_points(protocol.dimensions(count), seed, chunk)[:rows]
    loaded, unloaded, borne = tensions_n = np.empty((3, rows, arm.cable_count))
    redrawn = np.zeros(rows, dtype=np.int64)
    share = _MAX_REDRAWN_SHARE if protocol.randomise is None else 2.0 * _MAX_FAILING_SHARE
    allowed = math.ceil(share * rows)
    open_rows = np.arange(rows)
    while open_rows.size:
        try:
            tensions_n[:, open_rows] = resting.tensions_n(points[open_rows], open_rows, allowed)
        except EquilibriumError as error:
            raise DatasetError(
                f"samples {chunk * CHUNK_SAMPLES} and following: more than "
                f"{share:.0%} lie beyond arm {arm.identity}, for example: {error}"
            ) from error
        open_rows = np.flatnonzero(np.isnan(loaded).any(axis=1) | np.isnan(unloaded).any(axis=1))
        redrawn[open_rows] += 1
        allowed -= len(open_rows)
        # anew, but for the first coordinate: which segment, or how many, is touched
        points[open_rows, 1:] = stream.random((len(open_rows), points.shape[1] - 1))

    reading = loaded
    tare = unloaded
    if protocol.noise:
        noise = random_stream(NOISE, seed, chunk)
        reading = read_tensions_n(loaded, arm.sensors, noise)
        tare = np.zeros_like(unloaded)
        for _ in range(protocol.tare_samples):
            tare += read_tensions_n(unloaded, arm.sensors, noise)
        tare /= protocol.tare_samples
    return Dataset(
        arm=arm,
        protocol=protocol,
        seed=seed,
        sample_id=chunk * CHUNK_SAMPLES + np.arange(rows),
        tension_difference_n=reading - tare,
        unloaded_n=tare,
        slack_cables=(borne <= 0.0).sum(axis=1),
        redrawn=redrawn,
        **protocol.cases(resting.touched_m, points)._asdict(),
    )


class _Resting:
    """Samples of one chunk at rest, without noise; keeps the arms drawn for its blocks."""

    def __init__(self, arm: Arm, protocol: Protocol, seed: int, chunk: int) -> None:
        self._protocol = protocol
        self._mechanism = mechanism_of(arm)
        self.touched_m = protocol.touched_m(arm)
        self._listed = entries_of(arm)
        self._varied = bool(self._listed) or protocol.randomise is not None
        self._seed = seed, chunk
        self._arms: dict[int, tuple[list[EffectEntry], LoadHistory]] = {}

    def tensions_n(self, points: Array, rows: NDArray[np.int64], allowed: int) -> Array:
        """(3, B, M): loaded and unloaded readings, true loaded tensions; NaN without equilibrium.

        `points` (B, dimensions) lie in the unit cube, `rows` (B,) are theirs in the chunk.
        """
        cases = self._protocol.cases(self.touched_m, points)
        tensions_n = np.empty((3, len(points), self._mechanism.cable_count))
        blocks, members = np.divmod(rows, _BLOCK_SAMPLES if self._varied else CHUNK_SAMPLES)
        for block in np.unique(blocks):
            in_block = np.flatnonzero(blocks == block)
            of_block = Cases._make(part[in_block] for part in cases)
            tensions_n[:, in_block] = self._block(int(block), members[in_block], of_block, allowed)
            allowed -= int(np.isnan(tensions_n[0, in_block, 0]).sum())
        return tensions_n

    def _block(self, block: int, members: NDArray[np.int64], cases: Cases, allowed: int) -> Array:
        """Some `members` of a block, on the arm that was drawn for it or is now."""
        mechanism = self._mechanism
        randomise = self._protocol.randomise
        command, _, angles, magnitudes, places_m, along = cases
        forces = contact_forces_n(mechanism, command, angles, magnitudes, along)

        def readings(rows: NDArray[np.int64]) -> Array:
            entries, whole = self._arms[block]
            history = whole.select(members[rows])
            commands = history.commands_rad(command[rows])
            loads = history.loads_n(forces[rows])
            at_m = places_m[rows] if self._protocol.anywhere else None
            true = tensions_along_n(mechanism, entries, history.time_s, commands, loads, at_m)
            sensed = sensed_along_n(entries, history.time_s, true.swapaxes(0, 1))
            return np.stack([sensed[:, -1], sensed[:, TARED], true[-1]])

        shape = (3, len(command), mechanism.cable_count)
        if block in self._arms:
            return solved_rows(shape, allowed, readings)
        most = allowed if randomise is None else math.ceil(_MAX_FAILING_SHARE * len(members))
        rng = random_stream(ARM, *self._seed, block)
        for draws_left in reversed(range(1 if randomise is None else _MAX_ARMS_DRAWN)):
            entries = list(self._listed)
            if self._varied:
                history = LoadHistory.drawn(_BLOCK_SAMPLES, rng)
            else:
                history = LoadHistory.plain(CHUNK_SAMPLES)
            if randomise is not None:
                size = mechanism.segment_count, mechanism.cable_count
                entries += drawn_entries(effect_names(randomise), *size, rng)
            self._arms[block] = entries, history
            try:
                return solved_rows(shape, most, readings)
            except EquilibriumError:
                if not draws_left:
                    raise
        raise AssertionError("a loop that returns or raises")


_ON_THE_WAY = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
"""Shares of the way to the command, at which the arm comes to rest."""

_RISE = np.array([0.2, 0.4, 0.6, 0.8, 1.0])
"""Shares of the highest force on the way up."""

_BACK = np.array([0.5, 1.0, 1.0])
"""Shares of the way from there to the sample's force; the last is where it is read."""

_RESTS = len(_ON_THE_WAY) + len(_RISE) + len(_BACK)

TARED = len(_ON_THE_WAY) - 1
"""The rest at which the tare is taken; the reading is that of the last."""

_STEP_S = 0.5
"""From one rest to the next, at least."""
_LONGEST_WAIT_S = 30.0
"""Beyond that, before and after the tare."""
_LONGEST_HOLD_S = 5.0
"""How long a load is held before the reading."""
_HIGHEST_PEAK = 1.4
"""Of a load on the way, by the sample's force."""


@dataclass(frozen=True)
class LoadHistory:
    """What B samples go through in R rests: from another pose to the command, then the load.

    Attributes:
        time_s: (R,) of the rests.
        from_share: (B,) of the command, -1 to 1: the pose at the start.
        peak_share: (B,) of the sample's force, from 1 up: the highest force on the way.
    """

    time_s: Array
    from_share: Array
    peak_share: Array

    @classmethod
    def drawn(cls, count: int, rng: np.random.Generator) -> LoadHistory:
        """A history for `count` samples; half of them are loaded beyond their force and back."""
        steps = np.full(_RESTS, _STEP_S)
        steps[TARED] += rng.uniform(0.0, _LONGEST_WAIT_S)
        steps[TARED + 1] += rng.uniform(0.0, _LONGEST_WAIT_S)
        steps[-1] = rng.uniform(0.0, _LONGEST_HOLD_S)
        beyond = rng.random(count) < 0.5
        peak = np.where(beyond, rng.uniform(1.0, _HIGHEST_PEAK, count), 1.0)
        return cls(np.cumsum(steps), rng.uniform(-1.0, 1.0, count), peak)

    @classmethod
    def plain(cls, count: int) -> LoadHistory:
        """At the command and the force at once, for arms that do not depend on history."""
        return cls(np.arange(_RESTS, dtype=float), np.ones(count), np.ones(count))

    def select(self, rows: NDArray[np.int64]) -> LoadHistory:
        """The same for some of the samples."""
        return LoadHistory(self.time_s, self.from_share[rows], self.peak_share[rows])

    def commands_rad(self, command_rad: Array) -> Array:
        """(R, B, 2N) for the samples' commands (B, 2N)."""
        way = np.append(_ON_THE_WAY, np.ones(_RESTS - len(_ON_THE_WAY)))
        share = self.from_share + way[:, None] * (1.0 - self.from_share)
        return share[..., None] * command_rad

    def loads_n(self, forces_n: Array) -> Array:
        """(R, B, N, 3) for the samples' loads (B, N, 3)."""
        unloaded = np.zeros((len(_ON_THE_WAY), len(forces_n)))
        rise = _RISE[:, None] * self.peak_share
        back = self.peak_share + _BACK[:, None] * (1.0 - self.peak_share)
        return np.concatenate([unloaded, rise, back])[..., None, None] * forces_n


def solved_rows(
    shape: tuple[int, ...], allowed_failures: int, solve: Callable[[NDArray[np.int64]], Array]
) -> Array:
    """What `solve` gives for rows, the last axis but one of `shape`; NaN without equilibrium.

    Raises:
        EquilibriumError: more rows than allowed have none; it names one of the last.
    """
    whole = np.full(shape, np.nan)
    rows = np.arange(shape[-2])
    while rows.size:
        try:
            whole[..., rows, :] = solve(rows)
        except EquilibriumError as error:
            allowed_failures -= error.failed.size
            if not error.failed.size or allowed_failures < 0:
                raise
            rows = np.delete(rows, error.failed)
        else:
            break
    return whole


def tensions_along_n(
    nominal: Mechanism,
    entries: list[EffectEntry],
    time_s: Array,
    commands_rad: Array,
    loads_n: Array,
    places_m: Array | None = None,
) -> Array:
    """True tensions (R, B, M) of an arm with effects, from rest to rest at times (R,).

    Commands are (R, B, 2N), loads (R, B, N, 3). They act at `places_m` (B, N) from the segments'
    joint centres, by default at the arm's contact points. If nothing depends on the history,
    tensions are zero but at the tare and at the last rest. An `EquilibriumError` says which arms
    find no rest.
    """
    held = held_lengths_m(nominal, commands_rad)
    arms = [entries] * commands_rad.shape[1]
    for actuation in actuations(arms):
        held = actuation.along(time_s, held.swapaxes(0, 1)).swapaxes(0, 1)
    mechanism = amended(nominal, entries)
    if transmissions(arms):
        from cablesense_sim.quasi_static import QuasiStaticArm  # compiled: others need not wait

        arm = QuasiStaticArm([mechanism] * len(arms), arms)
        rests = zip(time_s, held, loads_n, strict=True)
        return np.stack([arm.step(*rest, places_m) for rest in rests])
    if places_m is not None:
        mechanism = replace(mechanism, contact_m=places_m)
    tensions = np.zeros_like(held)
    for row in range(len(held)) if sensings(arms) else (TARED, len(held) - 1):
        rest = solve_equilibrium(mechanism, commands_rad[row], loads_n[row], held_m=held[row])
        tensions[row] = rest.tensions_n
    return tensions


def sensed_along_n(entries: list[EffectEntry], time_s: Array, tensions_n: Array) -> Array:
    """Readings of tensions (B, R, M) at times (R,), with the sensors' effects."""
    for sensing in sensings([entries] * len(tensions_n)):
        tensions_n = sensing.along(time_s, tensions_n)
    return tensions_n
