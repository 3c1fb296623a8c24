"""Trials of a recording that names none: where one thing done to the arm ends and the next begins.

A new trial begins at a row where

- time has a gap,
- the command starts to move after standing still,
- a load starts after a rest without any, on another segment than the last load, or from another
  side.

What follows a load, the arm unloaded again, belongs to the load's trial: it shows what the load
left behind.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STILL_S = 1.0
"""A command that has not changed for this long stands still."""
REST_S = 3.0
"""An arm that has borne no load for this long is at rest; steps of a load come faster."""
GAP_S = 1.0
GAP_INTERVALS = 5.0
SAME_SIDE_COSINE = 0.866
"""Loads within 30 degrees of each other come from one side."""


def derive_trials(
    time_s: Array, command_rad: Array, load_segment: NDArray[np.int64], load_n: Array
) -> NDArray[np.int64]:
    """Trial (R,) of each row, from 0, for times (R,), commands (R, 2N) and loads (R,), (R, 3)."""
    if len(time_s) == 0:
        return np.zeros(0, dtype=np.int64)
    begins = _after_gap(time_s) | _starts_to_move(time_s, command_rad)
    begins |= _starts_to_bear(time_s, load_segment, load_n)
    begins[0] = False
    return np.cumsum(begins, dtype=np.int64)


def _after_gap(time_s: Array) -> NDArray[np.bool_]:
    intervals = np.diff(time_s)
    usual = float(np.median(intervals)) if intervals.size else 0.0
    return np.concatenate([[False], intervals > max(GAP_S, GAP_INTERVALS * usual)])


def _starts_to_move(time_s: Array, command_rad: Array) -> NDArray[np.bool_]:
    changed = np.concatenate([[False], (np.diff(command_rad, axis=0) != 0.0).any(axis=1)])
    # stamps as floats: a move every STILL_S must not count by their rounding
    return changed & (time_s - _last(time_s, changed) > STILL_S + 1e-6)


def _starts_to_bear(time_s: Array, segment: NDArray[np.int64], load_n: Array) -> NDArray[np.bool_]:
    loaded = segment > 0
    before = _last_row(loaded)
    known = before >= 0
    last = np.where(known, before, 0)
    rested = time_s - np.where(known, time_s[last], -np.inf) > REST_S + 1e-6
    size = np.linalg.norm(load_n, axis=1)
    along = (load_n * load_n[last]).sum(axis=1)
    other_side = along < SAME_SIDE_COSINE * size * size[last]
    return loaded & (rested | (segment != segment[last]) | other_side)


def _last(time_s: Array, marked: NDArray[np.bool_]) -> Array:
    """(R,) time of the latest marked row before each row; long ago where there is none."""
    row = _last_row(marked)
    return np.where(row >= 0, time_s[np.maximum(row, 0)], -np.inf)


def _last_row(marked: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(R,) number of the latest marked row before each row, -1 where there is none."""
    rows = np.where(marked, np.arange(len(marked)), -1)
    return np.concatenate([[-1], np.maximum.accumulate(rows)[:-1]]).astype(np.int64)
