"""A recording of an arm or another machine, as arrays: its trials, and which rows are used.

Rows are chosen, never averaged, because the noise of a reading must stay that of the sensors
(docs/diagnosis_method.md). The ends of each trial are kept, rows where the command or the load
turns back or leaps, because friction, backlash and creep are set there, and others at equal
distances. Fewer rows suffice to choose among effects that depend on the past (`rows_along_path`),
which are not needed at all where readings return with commands and load (`returns`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array, CableSenseError
from cablesense_sim.course import Course

_STILL_S = 1.0
"""A command that has not changed for this long stands still."""
_REST_S = 3.0
"""An arm without load for this long is at rest; steps of a load come faster."""
_PARTING_S = 1.0
"""Without a column of trials a break begins one where rows are farther apart than this, s, and"""
_PARTING_INTERVALS = 5.0
"""than this many usual intervals."""
_FROM_ZERO_INTERVALS = 5.0
"""A first stamp of 0 is a time where the next one is at most this many usual intervals later."""
_SAME_SIDE_COSINE = 0.866
"""Loads within 30 degrees of each other come from one side."""
SAME_PLACE_M = 0.002
"""Loads within 2 mm of each other act at one place."""

MAX_NUMBERS = 100_000_000
"""Size limit of a recording: an hour at 1 kHz of an arm with twelve cables, 0.8 GB in memory."""

_SHOWN = 5

MOST_READINGS = 72_000
"""Twenty minutes of twelve cables at 5 Hz: recordings by the protocol are used whole. More cables
add as many columns to each fit as they have readings, so that the time grows with the square."""
ENOUGH_HZ = 5.0
"""Rows a second that show all that a diagnosis looks for in a protocol of holds and slow loads,
beside the turns of commands and loads. A fit takes as much longer as it has more rows."""
ENOUGH_ROWS = 2_000
"""Rows that are used of any recording, if it has them."""
MOST_TRIALS = 500
"""The protocol of an arm with four segments has sixty."""

_LEAST_TURN = 0.01
_OTHER_SEGMENT = 100.0
"""In the units of a turn: a load that goes to another segment always counts, if anything does."""

_MOVING_STRIDE = 3
_RESTING_STRIDE = 10
_STRAIGHT_ON = 0.9
"""Cosine between two steps of commands and load, from which on they go in the same direction."""

_FEWEST_RETURNS = 100
_RETURNING_SHARE = 0.1
"""Differences, and the share of the rows in states that the arm came to from different sides."""

Rows = NDArray[np.int64]


class RecordingError(CableSenseError):
    """A recording that cannot be used: names the file, the rows, the fault and the remedy."""


class RowNames(NamedTuple):
    """What R rows are called in sentences: by their numbers in a file or a bag.

    Attributes:
        numbers: (R,) from 1 on, ascending; some may be left out.
        of_bag: whether they are of messages on the topic of the readings.
    """

    numbers: NDArray[np.int64]
    of_bag: bool = False

    def only(self, rows: NDArray[np.int64]) -> RowNames:
        """Those of some of the rows (K,), by their indices."""
        return self._replace(numbers=self.numbers[rows])

    def of(self, marked: NDArray[Any]) -> str:
        """Marked rows (R,): `row 7`, `rows 3 to 9 and 12`, `rows 1, 3 … (40 in all)`.

        Of a bag it is `message 7 of the readings` and so on.
        """
        numbers = self.numbers[marked]
        runs = np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1)
        named = [f"{run[0]} to {run[-1]}" if len(run) > 1 else f"{run[0]}" for run in runs]
        if len(named) > _SHOWN:
            which = f"{', '.join(named[:_SHOWN])} … ({len(numbers)} in all)"
        else:
            *first, last = named
            which = f"{', '.join(first)} and {last}" if first else last
        return self._said(which, several=len(numbers) > 1)

    def span(self, rows: slice) -> str:
        """Rows from the first to the last of a slice, whatever is left out between them."""
        numbers = self.numbers[rows]
        return self._said(f"{numbers[0]} to {numbers[-1]}", several=True)

    def _said(self, which: str, *, several: bool) -> str:
        plural = "s" if several else ""
        if self.of_bag:
            return f"message{plural} {which} of the readings"
        return f"row{plural} {which}"


@dataclass(frozen=True)
class Recording:
    """Commands, known loads and readings of an arm or another machine: R rows in time order.

    Names and shapes are those of an arm. A machine that MuJoCo describes has C commands, in rad of
    hinges and m of slides and of tendons, and M readings, in N of tendons and slides and N·m of
    hinges.

    Attributes:
        name: of the file it came from, without its suffix.
        time_s: (R,) since the recording began.
        trial: (R,) blocks that belong together; they are held out whole.
        command_rad: (R, 2N) commanded joint angles, pitch then yaw of each joint, base first; of a
            machine (R, C), or its measured joints.
        load_segment: (R,) 1 to N where a known load acts, else 0.
        load_n: (R, 3) that load, base frame.
        tensions_n: (R, M) as the sensors at the actuator ends read them; of a machine also joints'
            torques.
        load_at_m: (R,) where on its segment's axis the load acts, from the joint centre; NaN for
            the arm file's `contact_m`. None where no row states a place.
        message: (R,) which message of the readings' topic each row is, from 1; None where rows are
            those of a file.
        notes: what was read and how, as sentences.
        commanded_inside: whether the first command was given during the recording, so that the
            machine may be on its way to it in the first rows.
    """

    name: str
    time_s: Array
    trial: NDArray[np.int64]
    command_rad: Array
    load_segment: NDArray[np.int64]
    load_n: Array
    tensions_n: Array
    load_at_m: Array | None = None
    message: NDArray[np.int64] | None = None
    notes: tuple[str, ...] = ()
    commanded_inside: bool = False

    def __len__(self) -> int:
        """Number of rows R."""
        return len(self.time_s)

    @property
    def row_names(self) -> RowNames:
        """What its rows are called in sentences for people."""
        if self.message is not None:
            return RowNames(self.message, of_bag=True)
        return RowNames(np.arange(1, len(self) + 1))

    def where(self, marked: NDArray[np.bool_]) -> str:
        """Which rows (R,) are marked, in words."""
        return self.row_names.of(marked)

    @property
    def forces_n(self) -> Array:
        """(R, N, 3) the load as one base-frame force per segment."""
        return self._loaded[..., None] * self.load_n[:, None, :]

    @property
    def course(self) -> Course:
        """What the arm was put through, as `cablesense_sim.replay.Replay` takes it."""
        at_m = self.load_at_m
        places_m = None if at_m is None else np.where(self._loaded, at_m[:, None], np.nan)
        return Course(self.time_s, self.command_rad, self.forces_n, places_m)

    @property
    def _loaded(self) -> NDArray[np.bool_]:
        """(R, N) which segment the load acts on."""
        segments = np.arange(1, self.command_rad.shape[1] // 2 + 1)
        return np.asarray(self.load_segment[:, None] == segments)

    def rows(self, chosen: NDArray[Any] | slice) -> Recording:
        """The chosen rows: a mask (R,), indices or a slice."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        columns: dict[str, Any] = {
            name: each[chosen] for name, each in values.items() if isinstance(each, np.ndarray)
        }
        return replace(self, **columns)


EXCHANGED = "exchanged"
"""The kind of the finding that channels read each other's cables."""


@dataclass(frozen=True)
class Finding:
    """One problem of a recording.

    Attributes:
        refuses: whether it rules the recording out.
        kind: one word for programs, such as `time` or `exchanged`.
        text: what, where (rows from 1, columns by name) and what would be right.
    """

    refuses: bool
    kind: str
    text: str


refuse = partial(Finding, True)
warn = partial(Finding, False)


class BagClock(NamedTuple):
    """The one clock of R messages of a bag.

    Attributes:
        time_ns: (R,) since the epoch, or since simulated time began.
        notes: a sentence, if the times of arrival count though some messages have stamps.
    """

    time_ns: NDArray[np.int64]
    notes: tuple[str, ...] = ()


def one_clock(path: Path, arrival_ns: NDArray[np.int64], stamp_ns: NDArray[np.int64]) -> BagClock:
    """The one clock of messages (R,) of a bag that came at `arrival_ns`.

    Stamps count, also from 0 on, as simulated time begins. Where some are missing, which 0 stands
    for, the times of arrival count for all: rows of two clocks have no order.
    Stamps that run back are left to the checks of time, if none is missing.

    Raises:
        RecordingError: some stamps are missing, and the others run back.
    """
    missing = stamp_ns == 0
    steps_ns = np.diff(stamp_ns)
    begins_at_zero = (
        len(stamp_ns) > 1
        and bool((steps_ns > 0).all())
        and float(steps_ns[0]) <= _FROM_ZERO_INTERVALS * float(np.median(steps_ns))
    )
    if not missing.any() or begins_at_zero:
        return BagClock(stamp_ns)
    stated_steps_ns = np.diff(stamp_ns[~missing])
    if (stated_steps_ns <= 0).any():
        back_s = -1e-9 * float(stated_steps_ns.min())
        raise RecordingError(
            f"{path}: {int(missing.sum())} of {len(stamp_ns)} messages have no stamp, and by "
            f"those of the others time_s runs back by up to {back_s:.6g} s, so nothing says "
            "in which order they were read; see whether two nodes publish them, and record again"
        )
    if missing.all():
        return BagClock(arrival_ns)
    note = (
        f"Stamps are missing in {int(missing.sum())} of {len(stamp_ns)} messages, so the times of "
        "arrival count."
    )
    return BagClock(arrival_ns, (note,))


def refuse_unusable(
    recording: Recording, findings: Sequence[Finding], *, force: bool = False
) -> None:
    """Nothing, where no finding rules the recording out; with `force`, exchanged channels do not.

    Raises:
        RecordingError: the first reason that rules it out, and how many more there are.
    """
    refusals = [f.text for f in findings if f.refuses and not (force and f.kind == EXCHANGED)]
    if refusals:
        more = f" (and {len(refusals) - 1} more)" if len(refusals) > 1 else ""
        raise RecordingError(f"{recording.name}: {refusals[0]}{more}")


def given_places(load_at_m: Array | None) -> Array | None:
    """Places (R,) of loads; None where all are NaN."""
    return None if load_at_m is None or np.isnan(load_at_m).all() else load_at_m


def derive_trials(
    time_s: Array,
    command_rad: Array,
    load_segment: NDArray[np.int64],
    load_n: Array,
    load_at_m: Array | None = None,
) -> NDArray[np.int64]:
    """Trial (R,) of each row, from 0, of rows as in a `Recording`.

    One begins after a break, where the command starts to move after standing still, and
    where a load starts after a rest, on another segment, at another place or from another side.
    The arm unloaded again belongs to the trial of the load before, which it may still show.
    """
    if len(time_s) == 0:
        return np.zeros(0, dtype=np.int64)
    intervals = np.diff(time_s)
    usual = float(np.median(intervals)) if intervals.size else 0.0
    is_break = np.append(False, intervals > max(_PARTING_S, _PARTING_INTERVALS * usual))
    changed = np.append(False, (np.diff(command_rad, axis=0) != 0.0).any(axis=1))
    # stamps as floats: a move every _STILL_S must not count by their rounding
    moves = changed & (time_s - _last(time_s, changed)[1] > _STILL_S + 1e-6)
    loaded = load_segment > 0
    last, last_s = _last(time_s, loaded)
    size = np.linalg.norm(load_n, axis=1)
    other_side = (load_n * load_n[last]).sum(axis=1) < _SAME_SIDE_COSINE * size * size[last]
    rested = time_s - last_s > _REST_S + 1e-6
    other_place = load_segment != load_segment[last]
    if load_at_m is not None:
        same = np.isclose(load_at_m, load_at_m[last], rtol=0.0, atol=SAME_PLACE_M, equal_nan=True)
        other_place |= ~same
    begins = is_break | moves | (loaded & (rested | other_place | other_side))
    begins[0] = False
    return np.cumsum(begins, dtype=np.int64)


def _last(time_s: Array, marked: NDArray[np.bool_]) -> tuple[NDArray[np.int64], Array]:
    """(R,) number and time of the latest marked row before each; 0, long ago, if there is none."""
    rows = np.where(marked, np.arange(len(marked)), -1)
    before = np.append(-1, np.maximum.accumulate(rows)[:-1])
    return np.maximum(before, 0), np.where(before >= 0, time_s[before], -np.inf)


def rows_to_use(recording: Recording) -> Rows:
    """(K,) ascending; all rows where they and the trials are few enough.

    Of a recording at a high rate they are as many as one at `ENOUGH_HZ` would have, with the rows
    at which commands and loads turn or leap.
    """
    numbers, first, inverse = np.unique(recording.trial, return_index=True, return_inverse=True)
    rows = np.arange(len(recording))
    most = min(MOST_READINGS // recording.tensions_n.shape[1], _enough_rows(recording))
    if len(rows) <= most and len(numbers) <= MOST_TRIALS:
        return rows
    last = len(rows) - 1 - np.unique(recording.trial[::-1], return_index=True)[1]
    if len(numbers) > MOST_TRIALS:
        chosen = np.linspace(0, len(numbers) - 1, MOST_TRIALS).astype(int)
        rows = rows[np.isin(inverse, chosen)]
        first = first[chosen]
        last = last[chosen]
    kept = np.union1d(np.concatenate([first, last]), rows[_turns(recording.rows(rows), most // 2)])
    room = max(most - len(kept), 0)
    even = rows[np.linspace(0, len(rows) - 1, min(room, len(rows))).astype(int)]
    return np.union1d(kept, even)


def _enough_rows(recording: Recording) -> int:
    if len(recording) < 2:
        return len(recording)
    # pauses between trials are no part of it
    lasts_s = len(recording) * float(np.median(np.diff(recording.time_s)))
    return max(ENOUGH_ROWS, math.ceil(ENOUGH_HZ * lasts_s))


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
    visited = state[first]
    count = np.diff(first, append=len(state))
    came_from = np.append(-1, visited[:-1])
    mean = np.add.reduceat(recording.tensions_n, first) / count[:, None]
    square = 0.0
    degrees = 0
    visits = 0
    returning = np.zeros(len(recording), dtype=bool)
    for visited_state in np.unique(visited):
        state_visits = np.flatnonzero(visited == visited_state)
        if len(set(came_from[state_visits]) - {-1}) > 1:
            weighted = (
                count[state_visits, None]
                * (mean[state_visits] - np.average(mean[state_visits], 0, count[state_visits]))
                ** 2
            )
            square += float(weighted.sum())
            degrees += (len(state_visits) - 1) * mean.shape[1]
            visits += len(state_visits)
            returning |= state == visited_state
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
        turns = [
            _turned(*column_turns, least) for column_turns in zip(columns, turns, strict=True)
        ]
        leapt = [np.flatnonzero(leap >= least) for leap in leaps]
        turn_rows = np.unique(np.concatenate([*turns, *leapt, *(rows + 1 for rows in leapt)]))
        if len(turn_rows) <= most:
            return turn_rows
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
    turn_rows: list[int] = []
    way = 0
    high = (-np.inf, 0)
    low = (np.inf, 0)
    for end in zip(values[ends].tolist(), ends.tolist(), strict=True):
        high = max(high, end)
        low = min(low, end)
        if way >= 0 and high[0] - end[0] >= least:
            turn_rows.append(high[1])
            way = -1
            high = end
            low = end
        elif way <= 0 and end[0] - low[0] >= least:
            turn_rows.append(low[1])
            way = 1
            high = end
            low = end
    return np.array(turn_rows, dtype=np.int64)
