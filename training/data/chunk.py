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
"""

import math

import numpy as np
from numpy.typing import NDArray

from cablesense_sim.arm import Arm
from cablesense_sim.effects.entry import EffectEntry, entries_of
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.sensors import read_tensions_n
from cablesense_training.data.course import Course, course_readings_n
from cablesense_training.data.dataset import Dataset
from cablesense_training.data.design import (
    CHUNK_SAMPLES,
    arm_stream,
    chunk_sizes,
    noise_stream,
    redraw_stream,
    unit_points,
)
from cablesense_training.data.drawn_arm import drawn_entries, effect_names
from cablesense_training.data.errors import DatasetError
from cablesense_training.data.loads import contact_forces_n
from cablesense_training.data.protocols import Protocol
from cablesense_training.data.rest import TooManyFailures, tensions_at_rest_n

Array = NDArray[np.float64]

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
    come at the end of a `course` of their own.

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
        self._mechanism = Mechanism.from_arm(arm)
        self._listed = entries_of(arm)
        self._seed = seed, chunk
        self._drawn: dict[int, tuple[list[EffectEntry], Course]] = {}

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
            course, entries = Course.drawn(BLOCK_SAMPLES, rng), list(self._listed)
            if randomise is not None:
                arm = self._arm
                names = effect_names(randomise)
                entries += drawn_entries(names, arm.segment_count, arm.cable_count, rng)
            self._drawn[block] = entries, course
            try:
                return self._through(self._drawn[block], rows, command, forces, most)
            except TooManyFailures:
                if randomise is None or attempt + 1 == MAX_ARMS_DRAWN:
                    raise
        raise AssertionError("a loop that returns or raises")

    def _through(
        self,
        drawn: tuple[list[EffectEntry], Course],
        rows: NDArray[np.int64],
        command: Array,
        forces: Array,
        allowed: int,
    ) -> tuple[Array, Array, Array]:
        entries, course = drawn
        return course_readings_n(
            self._mechanism, entries, course.select(rows), command, forces, allowed
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
