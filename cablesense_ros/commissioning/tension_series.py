"""Readings of all sensors over some time, wherever from, and when the arm was at rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.recordings.recording import Recording

Array = NDArray[np.float64]

SETTLING_S = 1.0
"""How long after a change of pose or load the arm still swings."""


@dataclass(frozen=True)
class TensionSeries:
    """R readings of M sensors in time order.

    Attributes:
        cable_names: (M,).
        time_s: (R,) ascending.
        block: (R,) rows of one block follow each other without a wanted break.
        at_rest: (R,) whether the arm stood in one and the same pose with nothing touching it.
        tensions_n: (R, M).
        problems: what was already wrong when the readings came, a line each.
    """

    cable_names: tuple[str, ...]
    time_s: Array
    block: NDArray[np.int64]
    at_rest: NDArray[np.bool_]
    tensions_n: Array
    problems: tuple[str, ...] = ()

    @property
    def duration_s(self) -> float:
        """From the first reading to the last."""
        return float(self.time_s[-1] - self.time_s[0])


def series_of(recording: Recording, cable_names: tuple[str, ...]) -> TensionSeries:
    """A recording's readings; at rest is its most frequent pose without a load, once settled."""
    unloaded = recording.load_segment == 0
    at_rest = np.zeros(len(recording), dtype=bool)
    if unloaded.any():
        poses, number = np.unique(recording.command_rad, axis=0, return_inverse=True)
        number = number.reshape(-1)
        usual = int(np.bincount(number[unloaded], minlength=len(poses)).argmax())
        at_rest = unloaded & (number == usual)
    changed = np.concatenate([[False], np.diff(at_rest.astype(int)) == 1])
    for start_s in recording.time_s[changed].tolist():
        since_s = recording.time_s - start_s
        at_rest &= ~((since_s >= 0.0) & (since_s < SETTLING_S))
    return TensionSeries(
        cable_names, recording.time_s, recording.trial, at_rest, recording.tensions_n
    )


def without(series: TensionSeries, start_s: float, end_s: float) -> NDArray[np.bool_]:
    """(R,) at rest, and not from `start_s` to `end_s`, nor while the arm then settles."""
    touched = (series.time_s >= start_s) & (series.time_s <= end_s + SETTLING_S)
    return series.at_rest & ~touched
