"""One chunk of a dataset: what every worker computes, from arm, protocol, seed and chunk number.

A case can lie beyond the arm: on a compliant one, a large force at an unlucky pose bends a joint
until its guide plates meet, and no tension belongs to that. Such a case is drawn again (same
segments touched or same number of contacts, all else anew, from a random stream of its own), and
the row says how often. It is an exception, not a way of sampling: where more than
`MAX_REDRAWN_SHARE` of a chunk would need it, the protocol does not suit the arm and is refused.
"""

import math

import numpy as np
from numpy.typing import NDArray

from cablesense_sim.arm import Arm
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.sensors import read_tensions_n
from cablesense_training.data.dataset import Dataset
from cablesense_training.data.design import (
    CHUNK_SAMPLES,
    chunk_sizes,
    noise_stream,
    redraw_stream,
    unit_points,
)
from cablesense_training.data.errors import DatasetError
from cablesense_training.data.loads import contact_forces_n
from cablesense_training.data.protocols import Protocol
from cablesense_training.data.rest import TooManyFailures, tensions_at_rest_n

Array = NDArray[np.float64]

MAX_REDRAWN_SHARE = 0.02
"""Largest share of a chunk that may lie beyond the arm."""


def generate_chunk(arm: Arm, protocol: Protocol, seed: int, chunk: int) -> Dataset:
    """The samples of one chunk; the last chunk of a run may hold fewer than `CHUNK_SAMPLES`.

    A sample's reading is one sensor reading of the loaded arm at rest. Its tare is the mean of
    `tare_samples` readings of the unloaded arm at rest under the same command.

    Raises:
        DatasetError: the protocol does not fit the arm.
    """
    rows = chunk_sizes(protocol.samples)[chunk]
    count = arm.segment_count
    mechanism = Mechanism.from_arm(arm)
    stream = redraw_stream(seed, chunk)
    points = unit_points(protocol.dimensions(count), seed, chunk)[:rows]
    loaded, unloaded = np.empty((2, rows, arm.cable_count))
    redrawn = np.zeros(rows, dtype=np.int64)
    allowed = math.ceil(MAX_REDRAWN_SHARE * rows)
    open_rows = np.arange(rows)
    while open_rows.size:
        try:
            loaded[open_rows], unloaded[open_rows] = _rest(
                mechanism, protocol, points[open_rows], allowed
            )
        except TooManyFailures as error:
            raise DatasetError(
                f"samples {chunk * CHUNK_SAMPLES} and following: more than "
                f"{MAX_REDRAWN_SHARE:.0%} lie beyond arm {arm.identity}, for example: {error}"
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
        slack_cables=(loaded <= 0.0).sum(axis=1),
        redrawn=redrawn,
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
