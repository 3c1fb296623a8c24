"""The rows of a long recording that a diagnosis works on (docs/diagnosis_method.md).

Rows are chosen, never averaged, because the noise of a reading must stay that of the sensors. The
ends of each trial are kept, rows where the command or the load turns back or leaps, because
friction, backlash and creep are set there, and others at equal distances. Fewer rows suffice to
choose among effects that depend on the past (`rows_along_path`), which are not needed at all where
readings return with commands and load (`returns`).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_gap.recordings.recording import Recording

MOST_READINGS = 72_000
"""Twenty minutes of twelve cables at 5 Hz: recordings by the protocol are used whole. More cables
add as many columns to each fit as they have readings, so that the time grows with the square."""
MOST_TRIALS = 500
"""The protocol of an arm with four segments has sixty."""

_LEAST_TURN = 0.01
_OTHER_SEGMENT = 100.0
"""In the units of a turn: a load that goes to another segment always counts, if anything does."""

_MOVING_STRIDE, _RESTING_STRIDE = 3, 10
_STRAIGHT_ON = 0.9
"""Cosine between two steps of commands and load, from which on they go in the same direction."""

_FEWEST_RETURNS, _RETURNING_SHARE = 100, 0.1
"""Differences, and the share of the rows in states that the arm came to from different sides."""

Rows = NDArray[np.int64]


def rows_to_use(recording: Recording) -> Rows:
    """(K,) ascending; all rows where they and the trials are few enough."""
    numbers, first, inverse = np.unique(recording.trial, return_index=True, return_inverse=True)
    rows = np.arange(len(recording))
    most = MOST_READINGS // recording.tensions_n.shape[1]
    if len(rows) <= most and len(numbers) <= MOST_TRIALS:
        return rows
    last = len(rows) - 1 - np.unique(recording.trial[::-1], return_index=True)[1]
    if len(numbers) > MOST_TRIALS:
        chosen = np.linspace(0, len(numbers) - 1, MOST_TRIALS).astype(int)
        rows, first, last = rows[np.isin(inverse, chosen)], first[chosen], last[chosen]
    kept = np.union1d(np.concatenate([first, last]), rows[_turns(recording.rows(rows), most // 2)])
    room = max(most - len(kept), 0)
    even = rows[np.linspace(0, len(rows) - 1, min(room, len(rows))).astype(int)]
    return np.union1d(kept, even)


def rows_along_path(recording: Recording) -> Rows:
    """(K,) ascending rows that take an arm with friction along nearly the same path.

    It keeps the ends of each trial, turns, and rows where commands and load change direction or
    stop. It keeps every third of the other rows in motion, and every tenth at rest.
    """
    columns = np.array(list(_scaled(recording)))
    steps = np.diff(columns)
    size = np.linalg.norm(steps, axis=0)
    moves = np.abs(steps).max(axis=0) >= 1.0
    direction = np.where(moves, steps / np.maximum(size, 1.0), 0.0)
    bends = (direction[:, 1:] * direction[:, :-1]).sum(axis=0) < _STRAIGHT_ON
    kept = np.ones(len(recording), dtype=bool)
    kept[1:-1] = bends & (moves[1:] | moves[:-1])
    other_trial = np.flatnonzero(np.diff(recording.trial))
    kept[np.concatenate([other_trial, other_trial + 1])] = True
    for column in columns:
        kept[_turned(column, np.arange(len(recording)), 1.0)] = True
    last = 0
    for row in range(1, len(recording)):
        if row - last >= (_MOVING_STRIDE if moves[row - 1] else _RESTING_STRIDE):
            kept[row] = True
        if kept[row]:
            last = row
    return np.flatnonzero(kept)


def returns(recording: Recording, floor_n: float) -> tuple[float, NDArray[np.bool_]] | None:
    """RMS (N) by which readings differ where commands and load return, beyond the sensors' noise.

    It is an upper bound (95 %), and comes with the rows (R,) in such states. A state counts if the
    arm came to it from at least two others, as on loading and on unloading. None where a recording
    has too few of them to tell.
    """
    places = recording.load_at_m
    parts = [recording.command_rad, recording.load_segment[:, None], recording.load_n]
    parts += [] if places is None else [np.nan_to_num(places).reshape(len(recording), -1)]
    state = np.unique(np.concatenate(parts, axis=1), axis=0, return_inverse=True)[1].ravel()
    first = np.flatnonzero(np.diff(state, prepend=-1))
    visited, count = state[first], np.diff(first, append=len(state))
    came_from = np.append(-1, visited[:-1])
    mean = np.add.reduceat(recording.tensions_n, first) / count[:, None]
    square, degrees, visits = 0.0, 0, 0
    returning = np.zeros(len(recording), dtype=bool)
    for here in np.unique(visited):
        own = np.flatnonzero(visited == here)
        if len(set(came_from[own]) - {-1}) > 1:
            weighted = count[own, None] * (mean[own] - np.average(mean[own], 0, count[own])) ** 2
            square += float(weighted.sum())
            degrees += (len(own) - 1) * mean.shape[1]
            visits += len(own)
            returning |= state == here
    if degrees < _FEWEST_RETURNS or returning.mean() < _RETURNING_SHARE:
        return None
    beyond = max(square / degrees - floor_n**2, 0.0) + floor_n**2 * 2.0 * (2.0 / degrees) ** 0.5
    return float(np.sqrt(beyond * visits / returning.sum())), returning


def _turns(recording: Recording, most: int) -> Rows:
    """At most `most` rows where command or load turns back or leaps, by the largest changes."""
    columns = list(_scaled(recording))
    turns: list[Rows] = [np.arange(len(recording))] * len(columns)
    leaps = [np.abs(np.diff(column)) for column in columns]
    least = 1.0
    while True:
        turns = [_turned(*both, least) for both in zip(columns, turns, strict=True)]
        leapt = [np.flatnonzero(leap >= least) for leap in leaps]
        found = np.unique(np.concatenate([*turns, *leapt, *(rows + 1 for rows in leapt)]))
        if len(found) <= most:
            return found
        least *= 2.0


def _scaled(recording: Recording) -> Iterator[Array]:
    """Each commanded angle, component and place of the load (R,), in units of the least turn."""
    varied = [recording.command_rad, recording.load_n]
    if recording.load_at_m is not None:
        varied.append(np.nan_to_num(recording.load_at_m, nan=0.0)[:, None])
    for values in varied:
        largest = float(np.ptp(values, axis=0).max(initial=0.0))
        if largest > 0.0:
            yield from np.asarray(values.T / (_LEAST_TURN * largest))
    yield np.asarray(_OTHER_SEGMENT * recording.load_segment)


def _turned(values: Array, rows: Rows, least: float) -> Rows:
    """Those of some rows at which values (R,) turn, by `least` or more since the last turn."""
    if not len(rows):
        return rows
    change = np.diff(values[rows])
    moves = np.flatnonzero(change)
    # the last row of each stretch before it turns back, and the last of all
    ends = rows[np.append(moves[1:][np.diff(np.sign(change[moves])) != 0.0], len(rows) - 1)]
    found: list[int] = []
    way, high, low = 0, (-np.inf, 0), (np.inf, 0)
    for here in zip(values[ends].tolist(), ends.tolist(), strict=True):
        high, low = max(high, here), min(low, here)
        if way >= 0 and high[0] - here[0] >= least:
            found.append(high[1])
            way, high, low = -1, here, here
        elif way <= 0 and here[0] - low[0] >= least:
            found.append(low[1])
            way, high, low = 1, here, here
    return np.array(found, dtype=np.int64)
