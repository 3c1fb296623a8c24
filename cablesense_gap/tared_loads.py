"""The loads of a recording as a force estimator gets them: what tensions differ by from a tare."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.recordings.recording import Recording

Array = NDArray[np.float64]

AT_PEAK = 0.9
"""Rows count as being at a trial's peak from this share of its highest load on."""


@dataclass(frozen=True)
class TaredLoads:
    """B loaded rows of a recording that have a tare.

    Attributes:
        row: (B,) their numbers in the recording.
        tension_difference_n: (B, M) reading less tare.
        command_rad: (B, 2N) commanded joint angles.
        segment: (B,) 1 to N that the load acts on.
        force_n: (B, 3) the load, base frame.
        trial: (B,) position of the trial among those of the recording, from 0.
        at_peak: (B,) whether the load is near the highest of its trial.
    """

    row: NDArray[np.int64]
    tension_difference_n: Array
    command_rad: Array
    segment: NDArray[np.int64]
    force_n: Array
    trial: NDArray[np.int64]
    at_peak: NDArray[np.bool_]

    def __len__(self) -> int:
        """Number of rows B."""
        return len(self.row)


def tared_loads(recording: Recording) -> TaredLoads:
    """All loaded rows with a tare: the mean of the unloaded rows just before, at their command.

    A load under a command that was not rested at before has no tare and is left out.
    """
    tare = _tares_n(recording)
    trial = np.unique(recording.trial, return_inverse=True)[1]
    size = np.linalg.norm(recording.load_n, axis=1)
    peak = np.zeros(int(trial.max(initial=0)) + 1)
    np.maximum.at(peak, trial, size)
    row = np.flatnonzero((recording.load_segment > 0) & np.isfinite(tare).all(axis=1))
    return TaredLoads(
        row=row,
        tension_difference_n=recording.tensions_n[row] - tare[row],
        command_rad=recording.command_rad[row],
        segment=recording.load_segment[row],
        force_n=recording.load_n[row],
        trial=trial[row],
        at_peak=size[row] >= AT_PEAK * peak[trial[row]],
    )


def _tares_n(recording: Recording) -> Array:
    """(R, M) for loaded rows, NaN where there is none."""
    loaded = recording.load_segment > 0
    moved = np.concatenate([[True], (np.diff(recording.command_rad, axis=0) != 0.0).any(axis=1)])
    tare = np.full_like(recording.tensions_n, np.nan)
    first: int | None = None  # of the latest unloaded rows at the present command
    last = 0
    for row in range(len(recording)):
        if moved[row]:
            first = None
        if not loaded[row]:
            if first is None or loaded[row - 1]:
                first = row
            last = row
        elif first is not None:
            tare[row] = recording.tensions_n[first : last + 1].mean(axis=0)
    return tare
