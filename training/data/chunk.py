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
    CHUNK_SAMPLES,
    Protocol,
    arm_stream,
    chunk_sizes,
    drawn_entries,
    effect_names,
    noise_stream,
    redraw_stream,
    unit_points,
)
from cablesense_training.errors import DatasetError


class TooManyFailures(Exception):  # noqa: N818
    """More cases without equilibrium than were allowed; the text gives one, and why."""


def tensions_at_rest_n(
    mechanism: Mechanism, command_rad: Array, forces_n: Array, allowed_failures: int
) -> Array:
    """Tensions (B, M) for commands (B, 2N) and forces (B, N, 3); NaN in rows without equilibrium.

    Raises:
        TooManyFailures: more than `allowed_failures` rows have no equilibrium.
    """
    tensions = np.full((len(command_rad), mechanism.cable_count), np.nan)
    rows = np.arange(len(command_rad))
    try:
        rest = solve_equilibrium(mechanism, command_rad, forces_n)
    except EquilibriumError as error:
        if not 0 < error.failed.size <= allowed_failures:
            raise TooManyFailures(str(error)) from error
        rows = np.delete(rows, error.failed)
        rest = solve_equilibrium(mechanism, command_rad[rows], forces_n[rows])
    tensions[rows] = rest.tensions_n
    return tensions


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


def readings_after_n(
    nominal: Mechanism,
    entries: list[EffectEntry],
    history: LoadHistory,
    command_rad: Array,
    forces_n: Array,
    allowed_failures: int,
) -> tuple[Array, Array, Array]:
    """Loaded and unloaded readings without noise, and loaded tensions, each (B, M).

    NaN in rows that find no rest somewhere on their way.

    Raises:
        TooManyFailures: more rows than allowed find none.
    """
    found = np.full((3, len(command_rad), nominal.cable_count), np.nan)
    rows = np.arange(len(command_rad))
    while rows.size:
        try:
            tensions = _tensions_n(
                nominal, entries, history.select(rows), command_rad[rows], forces_n[rows]
            )
        except EquilibriumError as error:
            allowed_failures -= error.failed.size
            if not error.failed.size or allowed_failures < 0:
                raise TooManyFailures(str(error)) from error
            rows = np.delete(rows, error.failed)
            continue
        readings = tensions
        for sensing in sensings([entries] * len(rows)):
            read = [sensing.step(t, readings[r]) for r, t in enumerate(history.time_s)]
            readings = np.stack(read)
        found[:, rows] = readings[-1], readings[_TARED], tensions[-1]
        break
    return found[0], found[1], found[2]


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
    stream = redraw_stream(seed, chunk)
    points = unit_points(protocol.dimensions(count), seed, chunk)[:rows]
    loaded, unloaded, borne = np.empty((3, rows, arm.cable_count))
    redrawn = np.zeros(rows, dtype=np.int64)
    share = MAX_REDRAWN_SHARE if protocol.randomise is None else 2.0 * MAX_FAILING_SHARE
    allowed = math.ceil(share * rows)
    open_rows = np.arange(rows)
    while open_rows.size:
        try:
            loaded[open_rows], unloaded[open_rows], borne[open_rows] = resting(
                points[open_rows], open_rows, allowed
            )
        except TooManyFailures as error:
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
        noise = noise_stream(seed, chunk)
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
    """Readings without noise of the samples of one chunk, at points of the unit cube.

    Called with points (B, dimensions), their rows in the chunk and the number that may fail, it
    gives loaded and unloaded readings and the loaded tensions, each (B, M); NaN without rest.
    """

    def __init__(self, arm: Arm, protocol: Protocol, seed: int, chunk: int) -> None:
        self._arm, self._protocol = arm, protocol
        self._mechanism = mechanism_of(arm)
        self._listed = entries_of(arm)
        self._seed = seed, chunk
        self._drawn: dict[int, tuple[list[EffectEntry], LoadHistory]] = {}

    def __call__(
        self, points: Array, rows: NDArray[np.int64], allowed: int
    ) -> tuple[Array, Array, Array]:
        if self._listed or self._protocol.randomise is not None:
            return self._on_arms_with_effects(points, rows, allowed)
        loaded, unloaded = _rest(self._mechanism, self._protocol, points, allowed)
        return loaded, unloaded, loaded

    def _on_arms_with_effects(
        self, points: Array, rows: NDArray[np.int64], allowed: int
    ) -> tuple[Array, Array, Array]:
        cases = self._protocol.cases(self._mechanism.segment_count, points)
        forces = contact_forces_n(
            self._mechanism, cases.command_rad, cases.angles_deg, cases.magnitudes_n
        )
        found = np.empty((3, len(points), self._mechanism.cable_count))
        block = rows // BLOCK_SAMPLES
        for number in np.unique(block):
            own = np.flatnonzero(block == number)
            found[:, own] = self._block(
                int(number),
                rows[own] % BLOCK_SAMPLES,
                cases.command_rad[own],
                forces[own],
                allowed,
            )
            allowed -= int(np.isnan(found[0, own, 0]).sum())
        return found[0], found[1], found[2]

    def _block(
        self, block: int, rows: NDArray[np.int64], command: Array, forces: Array, allowed: int
    ) -> tuple[Array, Array, Array]:
        """Some rows of a block, on the arm that was drawn for it or is now."""
        known = self._drawn.get(block)
        if known is not None:
            return self._through(known, rows, command, forces, allowed)
        randomise = self._protocol.randomise
        most = allowed if randomise is None else math.ceil(MAX_FAILING_SHARE * len(rows))
        rng = arm_stream(*self._seed, block)
        for attempt in range(MAX_ARMS_DRAWN):
            history, entries = LoadHistory.drawn(BLOCK_SAMPLES, rng), list(self._listed)
            if randomise is not None:
                arm = self._arm
                names = effect_names(randomise)
                entries += drawn_entries(names, arm.segment_count, arm.cable_count, rng)
            self._drawn[block] = entries, history
            try:
                return self._through(self._drawn[block], rows, command, forces, most)
            except TooManyFailures:
                if randomise is None or attempt + 1 == MAX_ARMS_DRAWN:
                    raise
        raise AssertionError("a loop that returns or raises")

    def _through(
        self,
        drawn: tuple[list[EffectEntry], LoadHistory],
        rows: NDArray[np.int64],
        command: Array,
        forces: Array,
        allowed: int,
    ) -> tuple[Array, Array, Array]:
        entries, history = drawn
        return readings_after_n(
            self._mechanism, entries, history.select(rows), command, forces, allowed
        )


def _rest(
    mechanism: Mechanism, protocol: Protocol, points: Array, allowed_failures: int
) -> tuple[Array, Array]:
    """Loaded and unloaded tensions (B, M) at points of the unit cube; NaN without rest."""
    count = mechanism.segment_count
    cases = protocol.cases(count, points)
    command = cases.command_rad
    # the straight arm has one unloaded state
    poses = command if protocol.pose == "random" else command[:1]
    nothing = np.zeros((len(poses), count, 3))
    unloaded = np.empty((len(points), mechanism.cable_count))
    unloaded[:] = tensions_at_rest_n(mechanism, poses, nothing, allowed_failures)
    loaded = unloaded.copy()
    forces = contact_forces_n(mechanism, command, cases.angles_deg, cases.magnitudes_n)
    touched = np.flatnonzero(cases.contacts.any(axis=1))
    loaded[touched] = tensions_at_rest_n(
        mechanism, command[touched], forces[touched], allowed_failures
    )
    return loaded, unloaded
