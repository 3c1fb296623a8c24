"""The unloaded poses of a recording: what a calibration is made from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
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
    """The mean readings of stays at one command without a load, in time order.

    A touch during a stay may leave the cables slid in other ways, so what is read before and after
    it are two holds. Stretches that are too short to be one each make one together, of which it is
    not known how the cables have slid.

    Args:
        recording: in which `load_segment` is 0 where nothing acts on the arm.
        ended_ns: time of the last row since the epoch; 0 where it is not known.

    Raises:
        RecordingError: there is none.
    """
    holds: list[Unloaded] = []
    way = LastWay()
    end = 0
    for stretches in _stays(recording):
        stay_holds: list[_Hold] = []
        too_short: list[NDArray[np.int64]] = []
        for stretch in stretches:
            has_gap = stretch.start != end
            if has_gap or recording.trial[stretch.start] != recording.trial[end - 1]:
                way = LastWay()
            way = way.to(recording.command_rad[stretch.start])
            end = stretch.stop
            rows = _settled(recording, stretch)
            if len(rows) >= FEWEST_READINGS:
                stay_holds.append(_Hold(rows, way.came_from_rad))
            else:
                too_short.append(rows)
        together = np.concatenate(too_short) if too_short else np.zeros(0, dtype=np.int64)
        if len(together) >= FEWEST_READINGS:
            stay_holds.append(_Hold(together, None))
        stay_holds.sort(key=lambda hold: int(hold.rows[-1]))
        holds += [_mean_of(recording, hold, ended_ns) for hold in stay_holds]
    if not holds:
        raise RecordingError(
            f"{recording.name}: the arm never rests unloaded (load_segment 0) at one command for "
            f"longer than {SETTLING_S:g} s and {FEWEST_READINGS} readings; a calibration is made "
            "from such poses"
        )
    return holds


class _Hold(NamedTuple):
    """Settled readings at one command.

    Attributes:
        rows: (R,) numbers of the rows, in time order.
        came_from_rad: (C,) as of `Unloaded`.
    """

    rows: NDArray[np.int64]
    came_from_rad: Array | None


def _settled(recording: Recording, stretch: slice) -> NDArray[np.int64]:
    """(R,) the rows of an unloaded stretch once its move, or its touch, has settled."""
    rows = np.arange(stretch.start, stretch.stop)
    if stretch.start == 0:
        return rows  # nothing is known of a move before
    return rows[recording.time_s[rows] >= recording.time_s[stretch.start] + SETTLING_S]


def _mean_of(recording: Recording, hold: _Hold, ended_ns: int) -> Unloaded:
    last = hold.rows[-1]
    before_end_s = recording.time_s[-1] - recording.time_s[last]
    return Unloaded(
        reading_n=recording.tensions_n[hold.rows].mean(axis=0),
        command_rad=recording.command_rad[last],
        count=len(hold.rows),
        taken_ns=ended_ns - round(1e9 * before_end_s) if ended_ns else 0,
        came_from_rad=hold.came_from_rad,
    )


def _stays(recording: Recording) -> Iterator[list[slice]]:
    """The stretches without a load of each stay at one and the same command in one trial."""
    moved = (np.diff(recording.command_rad, axis=0) != 0.0).any(axis=1)
    other_trial = np.diff(recording.trial) != 0
    for start, stop in _runs(moved | other_trial):
        unloaded = recording.load_segment[start:stop] == 0
        stretches = [
            slice(start + first, start + behind)
            for first, behind in _runs(np.diff(unloaded.astype(int)) != 0)
            if unloaded[first]
        ]
        yield stretches


def _runs(changes: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """First rows of runs, and the rows behind them, where (R - 1,) say what changes between."""
    ends = np.flatnonzero(changes) + 1
    return pairwise([0, *ends.tolist(), len(changes) + 1])
