"""Checks of the channels of recordings, of any format: clocks and dead channels.

Clocks (`time_findings`), numbers of no measurement and silent rows are checked of any machine.
Breaks (`robot_breaks`), uneven times, and what joints do by themselves (`dead_…`, `leaps_…`,
`position_leaps`) are checked of robots alone, whose motion between rows is computed; an arm's
breaks are in `recording.derive_trials` and `checks`.

Rows are counted from 1, as people count them in a file. Of a bag the messages of the readings are
counted, those before the first row too; of a robot's, whose rows may be put together from several
topics, these rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, median_filter

from cablesense_base import Array, some_of
from cablesense_recording.channels import TIME, Channel
from cablesense_recording.recording import Finding, RowNames, refuse, warn

DEAD = "dead"
"""The kind of the finding that a channel does not follow what it measures."""

_MOST = 1e9
"""No tension, torque, command or place is larger, in whatever unit."""
_FOREIGN_INTERVALS = 10.0
"""A single stamp that is off by more of the usual intervals is of another clock."""
_ROBOT_BREAK_INTERVALS = 5.0
"""A robot's recording has a break where rows are farther apart than this many usual intervals,
and"""
_ROBOT_BREAK_S = 0.1
"""than this, s: nothing is known of the motion between."""
_MOST_BREAKS = 0.05
"""Share of rows before which there is a break, above which these are no times of samples."""
_UNEVEN = 3.0
"""Mean interval by the median one, above which it is none either."""
_BY_CHANCE = 1e-9
"""Probability below which readings that are equal are no chance."""
_DEAD_ROWS = 20
"""Rows in which a dead channel stands still, at the least."""
_DEAD_SHARE = 0.2
"""Share of all rows from which on a channel that stands still is dead,"""
_DOUBTFUL_SHARE = 0.05
"""and from which on it is doubtful."""
_MOVES = 0.1
"""A joint moves where it goes to and fro by this share of its whole span."""
_SPIKE_SHARE = 0.05
"""A single reading is no motion where it is off by this share of the span, and"""
_SPIKE_STEPS = 5.0
"""by this many usual steps, and where"""
_RETURNS = 0.25
"""the next row is back but for this share of that."""
_LEAST_SPIKE = {"rad": 0.01, "m": 0.001}
"""Encoders of joints that rest toggle by less."""
_MOST_SPIKES = 5
"""Spikes from which on they are another source's readings."""
_AROUND = 11
"""Rows around a step whose median is the usual one there."""
_LEAP_STEPS = 8.0
"""A step is none of a joint that moves where it is off the steps around it by more than this
multiple of what is usual there, and"""
_MOST_TIMES = 3.0
"""by more than this multiple of what"""
_MOST_PERCENT = 99.0
"""this percentage of all steps are off at most, and"""
_LEAP_SHARE = 0.1
"""by more than this share of the span."""
_HIT_ROWS = 9
"""About the row where a joint is hit: a parabola that has the hit within it is off, too."""
_BESIDE = 6
"""Rows before a step, and rows after it, through which a parabola each is laid. Between them these
differ by a leap, and by next to nothing where a joint is hit, which turns speeds alone."""
_LEAST_OFF = 0.005
"""A leap is more than this share of the span, and"""
_MOST_OFF = 10.0
"""more than this multiple of what"""
_OFF_PERCENT = 90.0
"""this percentage of the largest differences around it are at most."""
_LAGS = (2, 3)
"""Rows so far apart are of one source, where two or three send by turns:"""
_ALTERNATING = 0.5
"""they differ by less than this share of what neighbours differ by."""


def time_findings(
    time_s: Array, may_restart: NDArray[np.bool_], names: RowNames, *, of_bag: bool
) -> Iterator[Finding]:
    """Where a clock (R,) stands still, runs back, or gives way to another for one row.

    It may begin anew in rows that `may_restart` (R,) marks. In a bag, other than in a file, no row
    can be moved or left out, so what can be done is to record again.
    """
    steps_s = np.diff(time_s)
    back = np.flatnonzero((steps_s <= 0.0) & ~may_restart[1:])
    if not back.size:
        return
    last = int(back[0])
    row = last + 1
    usual_s = float(np.median(steps_s[steps_s > 0.0])) if (steps_s > 0.0).any() else 0.0
    back_s = -float(steps_s[last])
    if back_s == 0.0:
        still = np.append(False, (steps_s == 0.0) & ~may_restart[1:])
        remedy = "leave out rows that stand twice"
        if of_bag:
            remedy = "have each message stamped when it is read, and published once"
        yield refuse(
            "time",
            f"{TIME} stands still in {names.of(still)}; each must be later than the one before: "
            f"{remedy}",
        )
        return
    alone = back_s > _FOREIGN_INTERVALS * usual_s
    if alone and last > 0 and time_s[row] > time_s[last - 1]:
        foreign = last
    elif alone and row + 1 < len(time_s) and time_s[row + 1] > time_s[last]:
        foreign = row
    else:
        more = f" (and in {len(back) - 1} more)" if len(back) > 1 else ""
        remedy = "sort the rows, or part the file where its clock was set"
        if of_bag:
            remedy = "see whether two nodes publish them or a clock was set, and record again"
        yield refuse(
            "time",
            f"{TIME} runs back by {back_s:.6g} s in {names.of(_only(row, time_s))}{more}; each "
            f"must be later than the one before: {remedy}",
        )
        return
    remedy = "leave that row out"
    if of_bag:
        remedy = "see which node sent it, and record again"
    yield refuse(
        "time",
        f"{TIME} is {time_s[foreign]:.6g} in {names.of(_only(foreign, time_s))}, of another clock "
        f"than those around it, from which it runs back by {back_s:.6g} s; {remedy}",
    )


def _only(row: int, values: Array) -> NDArray[np.bool_]:
    """(R,) that marks one row."""
    return np.arange(len(values)) == row


def _counted_from(first_row: int, count: int) -> RowNames:
    """Names of rows of which the first has a number."""
    return RowNames(first_row + np.arange(count))


def huge_values(label: str, values: Array, names: RowNames) -> Iterator[Finding]:
    """Where a channel (R,) has a number that is none of a measurement, as a broken message has."""
    huge = np.abs(np.nan_to_num(values)) > _MOST
    if huge.any():
        remedy = "leave these rows out"
        if names.of_bag:
            remedy = "see what their publisher sends, and record again"
        yield refuse(
            "huge",
            f"{label} is {values[huge][0]:.3g} in {names.of(huge)}; no reading is beyond "
            f"{_MOST:g}: {remedy}",
        )


def robot_breaks(time_s: Array, trial: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(R,) whether a robot's recording has a break within a trial before a row."""
    steps_s = np.diff(time_s)
    within = np.diff(trial) == 0
    if not within.any():
        return np.zeros(len(time_s), dtype=bool)
    usual_s = float(np.median(steps_s[within]))
    is_break = (steps_s > max(_ROBOT_BREAK_INTERVALS * usual_s, _ROBOT_BREAK_S)) & within
    return np.append(False, is_break)


def uneven_time(time_s: Array, trial: NDArray[np.int64]) -> Iterator[Finding]:
    """Whether times (R,) of rows in trials, already parted at breaks, are none of samples."""
    steps_s = np.diff(time_s)[np.diff(trial) == 0]
    parts = len(time_s) - len(steps_s)
    if not steps_s.size:
        return
    mean_s = float(steps_s.mean())
    usual_s = float(np.median(steps_s))
    if mean_s > _UNEVEN * usual_s or parts > max(_MOST_BREAKS * len(time_s), 2.0):
        yield refuse(
            "uneven",
            f"{TIME} comes in bursts: rows are {usual_s:.3g} s apart at the median and "
            f"{np.diff(time_s).mean():.3g} s on average; record the time at which each row was "
            "measured",
        )


def parted_sentence(time_s: Array, is_break: NDArray[np.bool_], first_row: int = 1) -> str:
    """What is done at the breaks (R,) of a robot's recording."""
    largest_s = float(np.diff(time_s)[is_break[1:]].max())
    named = _counted_from(first_row, len(is_break)).of(is_break)
    return (
        f"{TIME} has a break of {largest_s:.3g} s before {named}: the trial is parted "
        "there, and nothing is interpolated."
    )


def constant_channels(labels: Sequence[str], values: Array) -> list[int]:
    """Numbers of the channels (R, C) that have one finite value in every row."""
    return [
        number
        for number in range(len(labels))
        if np.isfinite(values[:, number]).all() and np.ptp(values[:, number]) == 0.0
    ]


def silent_rows(values: Array) -> slice | None:
    """The rows (R,) in which a channel stands still though it has noise elsewhere, if any.

    Of readings that are equal to the one before in a share p of all others, n equal ones in a row
    have the probability p^n at each of R places.
    """
    run = longest_run(values)
    count = run.stop - run.start
    others = np.append(np.diff(values[: run.start + 1]), np.diff(values[run.stop - 1 :]))
    if count < _DEAD_ROWS or len(others) < _DEAD_ROWS:
        return None
    equal = (np.count_nonzero(others == 0.0) + 1.0) / (len(others) + 2.0)  # by Laplace's rule
    chance = np.log(len(values)) + (count - 1) * np.log(equal)
    return run if chance < np.log(_BY_CHANCE) else None


def dead_torque(
    label: str, torque: Array, position: Array, trial: NDArray[np.int64], first_row: int = 1
) -> Iterator[Finding]:
    """Whether the torque (R,) of a joint stands still while the joint moves to and fro (R,).

    Friction, weight or inertia changes any torque there; a joint at rest may hold one for ever.
    """
    run = longest_run(torque)
    count = run.stop - run.start
    share = count / len(torque)
    moves = to_and_fro(position[run], trial[run]) >= _MOVES * np.ptp(position)
    if count < _DEAD_ROWS or share < _DOUBTFUL_SHARE or not moves:
        return
    finding = refuse if share >= _DEAD_SHARE else warn
    rows = f"rows {run.start + first_row} to {run.stop + first_row - 1}"
    yield finding(
        DEAD,
        f"{label} is {torque[run.start]:g} in {rows}, while its joint moves to and fro; see "
        "whether its sensor is connected, and leave these rows out",
    )


def dead_position(
    labels: Sequence[str], position: Array, number: int, first_row: int = 1
) -> Iterator[Finding]:
    """Whether a joint (R, J) stands still from some row on, or up to it, while others move."""
    run = longest_run(position[:, number])
    count = run.stop - run.start
    at_an_end = run.start == 0 or run.stop == len(position)
    span = np.ptp(position, axis=0)
    moved = np.ptp(position[run], axis=0) >= _MOVES * np.maximum(span, 1e-12)
    moving = [labels[other] for other in np.flatnonzero(moved).tolist() if other != number]
    if count < max(_DEAD_ROWS, _DEAD_SHARE * len(position)) or not (at_an_end and moving):
        return
    rows = f"rows {run.start + first_row} to {run.stop + first_row - 1}"
    where = "every row" if count == len(position) else rows
    yield warn(
        DEAD,
        f"{labels[number]} is {position[run.start, number]:g} in {where}, while "
        f"{some_of(moving, 3)} {'changes' if len(moving) == 1 else 'change'}; if that joint moved "
        "there, its encoder is dead and the verdict is wrong",
    )


def leaps_and_returns(
    channel: Channel, position: Array, trial: NDArray[np.int64], first_row: int = 1
) -> Iterator[Finding]:
    """Whether readings (R,) of a joint leap away for a row and return, as no joint moves."""
    least = _LEAST_SPIKE[channel.unit]
    label = channel.label
    if len(position) < 2 * _DEAD_ROWS or np.ptp(position) < least:
        return
    step = np.abs(np.diff(position)) * (np.diff(trial) == 0)
    off = np.zeros(len(position))
    off[1:-1] = np.abs(position[1:-1] - 0.5 * (position[2:] + position[:-2]))
    around = np.zeros(len(position))
    around[1:-1] = np.abs(position[2:] - position[:-2])
    usual = median_filter(np.append(step, step[-1:]), size=_AROUND, mode="nearest")
    spike = off > np.maximum(_SPIKE_STEPS * usual, max(_SPIKE_SHARE * np.ptp(position), least))
    spike &= around < _RETURNS * off
    spike[1:] &= np.diff(trial) == 0
    spike[:-1] &= np.diff(trial) == 0
    names = _counted_from(first_row, len(spike))
    remedy = "record one publisher on a topic, and see whether the encoder is well"
    if spike.sum() >= _MOST_SPIKES:
        yield refuse(
            "publishers",
            f"{label} leaps away and back in {names.of(spike)}: another publisher's readings "
            f"among its own, or an encoder that fails; {remedy}",
        )
    elif spike.any():
        yield warn("glitch", f"{label} leaps away and back in {names.of(spike)}")
    neighbours = np.sqrt((step**2).mean())
    for lag in _LAGS:
        apart = (position[lag:] - position[:-lag])[trial[lag:] == trial[:-lag]]
        if apart.size and np.sqrt((apart**2).mean()) < _ALTERNATING * neighbours:
            yield refuse(
                "publishers",
                f"{label} goes to and fro from row to row, as readings of {lag} publishers by "
                f"turns; {remedy}",
            )
            return


def position_leaps(position: Array, trial: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(R,) whether a joint (R, J) leaps within a trial before a row, as none moves."""
    step = np.diff(position, axis=0) * (np.diff(trial) == 0)[:, None]
    if len(step) < _AROUND:
        return np.zeros(len(position), dtype=bool)
    off = np.abs(step - median_filter(step, size=(_AROUND, 1), mode="nearest"))
    usual = median_filter(off, size=(_AROUND, 1), mode="nearest")
    most = np.percentile(off, _MOST_PERCENT, axis=0)
    leap = off > np.maximum(_LEAP_STEPS * usual, _MOST_TIMES * most)
    leap &= off > _LEAP_SHARE * np.ptp(position, axis=0)
    leap &= (np.diff(trial) == 0)[:, None]
    large = np.append(False, leap.any(axis=1))
    parted = trial + np.cumsum(large)
    return np.asarray(large | _small_leaps(position, parted))


def _small_leaps(position: Array, trial: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(R,) whether the motion (R, J) before a row does not lead to that after it."""
    share = [_share_of_leap(joint_position, trial) for joint_position in position.T]
    most = np.max(share, axis=0)
    return np.asarray((most > 1.0) & _peaks(most))


def _share_of_leap(position: Array, trial: NDArray[np.int64]) -> Array:
    """(R,) how far off the motion of a joint (R,) a row is, as a share of a leap."""
    off = _off_the_motion(position, trial)
    peak = _peaks(off)
    # of few peaks the largest may be the leap itself, which says nothing of what is usual
    usual = float(np.percentile(off[peak], _OFF_PERCENT, method="lower")) if peak.any() else 0.0
    least = max(_MOST_OFF * usual, _LEAST_OFF * float(np.ptp(position)))
    return off / least if least > 0.0 else off


def _peaks(values: Array) -> NDArray[np.bool_]:
    """(R,) the largest of their surroundings."""
    around = maximum_filter1d(values, 2 * _BESIDE + 1)
    return np.asarray((around == values) & (values > 0.0))


def _off_the_motion(position: Array, trial: NDArray[np.int64]) -> Array:
    """(R,) how far parabolas through the rows before and from each row differ between these.

    Where a joint is hit between two rows, its position goes on with another speed: parabolas then
    differ by half of what the speed has changed by, at most, and that does not count. It is 0
    where a trial has too few rows on either side.
    """
    rows = len(position)
    off = np.zeros(rows)
    if rows < 2 * _BESIDE:
        return off
    # p(x) = a + b x + c x^2 at x = 1/2, 3/2 … rows from the step; a is the value there
    away = np.arange(_BESIDE) + 0.5
    at_step, speed_at_step, _ = np.linalg.pinv(np.vander(away, 3, increasing=True))
    windows = sliding_window_view(position, 2 * _BESIDE)
    before = windows[:, :_BESIDE] @ at_step[::-1]
    after = windows[:, _BESIDE:] @ at_step
    speed_before = -windows[:, :_BESIDE] @ speed_at_step[::-1]
    speed_after = windows[:, _BESIDE:] @ speed_at_step
    turn = np.abs(speed_after - speed_before)
    is_hit = turn > _MOST_OFF * np.percentile(turn, _OFF_PERCENT)
    by_hit = maximum_filter1d(0.5 * turn * is_hit, _HIT_ROWS)
    together = trial[2 * _BESIDE - 1 :] == trial[: rows - 2 * _BESIDE + 1]
    apart = np.maximum(np.abs(after - before) - by_hit, 0.0)
    off[_BESIDE : rows - _BESIDE + 1] = apart * together
    return off


def leap_sentence(
    labels: Sequence[str], position: Array, leap: NDArray[np.bool_], first_row: int = 1
) -> str:
    """What is done where positions (R, J) leap (R,)."""
    step = np.abs(np.diff(position, axis=0))[leap[1:]].max(axis=0)
    worst = int((step / np.maximum(np.ptp(position, axis=0), 1e-12)).argmax())
    named = _counted_from(first_row, len(leap)).of(leap)
    return (
        f"{labels[worst]} leaps by {step[worst]:.3g} before {named}, as no joint "
        "moves: the trial is parted there."
    )


def longest_run(values: Array) -> slice:
    """The rows (R,) of the longest run of one value."""
    edges = np.flatnonzero(np.concatenate([[True], np.diff(values) != 0.0, [True]]))
    longest = int(np.diff(edges).argmax())
    return slice(int(edges[longest]), int(edges[longest + 1]))


def to_and_fro(values: Array, trial: NDArray[np.int64]) -> float:
    """How far values (R,) go one way and back again; from one trial to the next they may leap."""
    if len(values) < 2:
        return 0.0
    path = np.append(0.0, np.cumsum(np.diff(values) * (np.diff(trial) == 0)))
    rise = (path - np.minimum.accumulate(path)).max()
    fall = (np.maximum.accumulate(path) - path).max()
    return float(min(rise, fall))
