"""The unloaded poses of a recording: what a calibration is made from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from cablesense_contact.cable_slides import LastWay
from cablesense_contact.calibration import Unloaded
from cablesense_recording.recording import Recording, RecordingError

SETTLING_S = 1.0
"""Readings this soon after a move, or after a load was taken off, are left out."""
FEWEST_READINGS = 3
"""Of a hold that counts, after it has settled."""
_ONE_POSE = 1e-3
"""Measured joints are in one pose while they are within this of its first row, rad or m."""


def with_held_positions(recording: Recording) -> Recording:
    """A recording of measured positions, which have noise, as if each pose had been commanded.

    Rows whose joints stay within a milliradian of the first of them have the mean of all.
    """
    positions = recording.command_rad.copy()
    first = 0
    for row in range(1, len(positions) + 1):
        ends = row == len(positions)
        if ends or np.abs(positions[row] - recording.command_rad[first]).max() > _ONE_POSE:
            positions[first:row] = positions[first:row].mean(axis=0)
            first = row
    return replace(recording, command_rad=positions)


def unloaded_holds(recording: Recording, ended_ns: int = 0) -> list[Unloaded]:
    """The mean reading of each stay at one command without a load, in time order.

    Args:
        recording: in which `load_segment` is 0 where nothing acts on the arm.
        ended_ns: time of the last row since the epoch; 0 where it is not known.

    Raises:
        RecordingError: there is none.
    """
    holds: list[Unloaded] = []
    way = LastWay()
    end = 0
    for rows in _stays(recording):
        if rows.start != end or recording.trial[rows.start] != recording.trial[end - 1]:
            way = LastWay()
        way = way.to(recording.command_rad[rows.start])
        end = rows.stop
        begun_s = recording.time_s[rows.start]
        times_s = recording.time_s[rows]
        settled = times_s >= begun_s + SETTLING_S
        if rows.start == 0:
            settled[:] = True  # nothing is known of a move before
        if settled.sum() < FEWEST_READINGS:
            continue
        before_end_s = recording.time_s[-1] - times_s[-1]
        taken_ns = ended_ns - round(1e9 * before_end_s) if ended_ns else 0
        readings_n = recording.tensions_n[rows][settled]
        command_rad = recording.command_rad[rows.start]
        holds.append(
            Unloaded(
                readings_n.mean(axis=0), command_rad, len(readings_n), taken_ns, way.came_from_rad
            )
        )
    if not holds:
        raise RecordingError(
            f"{recording.name}: the arm never rests unloaded (load_segment 0) at one command for "
            f"longer than {SETTLING_S:g} s and {FEWEST_READINGS} readings; a calibration is made "
            "from such poses"
        )
    return holds


def _stays(recording: Recording) -> Iterator[slice]:
    """Runs of rows without a load and with one and the same command."""
    unloaded = recording.load_segment == 0
    moved = (np.diff(recording.command_rad, axis=0) != 0.0).any(axis=1)
    other_trial = np.diff(recording.trial) != 0
    loaded = np.diff(unloaded.astype(int)) != 0
    ends = np.flatnonzero(moved | loaded | other_trial) + 1
    bounds = [0, *ends.tolist(), len(recording)]
    for start, stop in pairwise(bounds):
        if unloaded[start]:
            yield slice(start, stop)
