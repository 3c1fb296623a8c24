"""How large a change must be for the gap that is wanted of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.plant.change import Change
from cablesense_gap.plant.plant_error import PlantError
from cablesense_gap.plant.protocol import Schedule
from cablesense_gap.plant.real_arm import RealArm, signals_n

Array = NDArray[np.float64]

_TRIES = 6
_NEAR = 1.25
_STRIDE = 6
_RETREAT = 0.4


def gap_n(first_n: Array, second_n: Array) -> float:
    """Root mean square difference of two recordings over rows and cables."""
    return float(np.sqrt(np.mean((first_n - second_n) ** 2)))


def size_for(
    change: Change, arm: RealArm, wanted_n: float, schedule: Schedule, history: Schedule
) -> float:
    """Size within the change's bounds whose gap against the arm without it is nearest.

    By secants in the logarithms, to within some percent; an arm that remembers is tried on every
    sixth row. A size that leaves no rest lowers the upper bound.
    """
    low, high = np.log(change.least), np.log(change.most)
    rows = rows_to_try(change, arm, schedule)
    without = signals_n(arm, rows, history)
    at, best, nearest = 0.5 * (low + high), low, np.inf
    steepness, last = 1.0, None
    for _ in range(_TRIES):
        try:
            gap = gap_n(signals_n(change.apply(arm, float(np.exp(at))), rows, history), without)
        except PlantError:
            high = at + np.log(_RETREAT)
            at = min(0.5 * (low + at), high)
            continue
        off = np.log(max(gap, 1e-6) / wanted_n)
        if abs(off) < nearest:
            best, nearest = float(np.clip(at - off, low, high)), abs(off)
        if nearest < np.log(_NEAR):
            break
        if last is not None and abs(at - last[0]) > 1e-6:
            steepness = float(np.clip((off - last[1]) / (at - last[0]), 0.3, 3.0))
        last = at, off
        at = float(np.clip(at - off / steepness, low, high))
        if abs(at - last[0]) < 1e-6:
            break
    return float(np.exp(best))


def rows_to_try(change: Change, arm: RealArm, schedule: Schedule) -> Schedule:
    """The rows of a schedule that a gap is told from: fewer where each waits for the last."""
    remembers = change.apply(arm, change.least).remembers
    return every(schedule, _STRIDE) if remembers else schedule


def every(schedule: Schedule, stride: int) -> Schedule:
    """Every so many rows of a schedule."""
    chosen = slice(None, None, stride)
    return replace(
        schedule,
        time_s=schedule.time_s[chosen],
        trial=schedule.trial[chosen],
        command_rad=schedule.command_rad[chosen],
        load_segment=schedule.load_segment[chosen],
        load_n=schedule.load_n[chosen],
    )
