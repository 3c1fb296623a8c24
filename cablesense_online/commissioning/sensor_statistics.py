"""Statistics of tension readings: noise, quantisation step, drift, timing, movement under pulls.

A series of readings comes from a recording or live; noise and drift are those at rest, that is in
static equilibrium in one pose with nothing touching the arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from scipy.stats import linregress

from cablesense_base import Array
from cablesense_gap.recordings.recording import Recording
from cablesense_online.commissioning.tables import CommissioningError, Pull

SETTLING_S = 1.0
"""How long after a change of pose or load the arm still swings."""
WINDOW_S = 1.0
"""Within it changes beyond those of a straight line count as noise."""
WINDOW_SAMPLES = 10
"""A window has at least so many."""
FEWEST_VALUES = 3
"""Different values without which a step cannot be distinguished from chance."""
STEP_SCATTER = 0.1
"""Values further than this share of a step from whole steps are not on steps."""
FEWEST_INTERVALS = 20
"""With fewer, neither a rate nor noise can be estimated."""
BEFORE_S = 1.0
"""A pull is compared with the time just before."""
FEWEST_SAMPLES = 3
CLEARLY = 0.7
"""Where the second channel moves by more than this share of the first, a pull is unclear."""
PULLED_FLOORS = 10.0
"""A pull counts from so many standard deviations of the readings on."""


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
    time_s = recording.time_s
    for start_s in time_s[changed].tolist():
        since_s = time_s - start_s
        at_rest &= ~((since_s >= 0.0) & (since_s < SETTLING_S))
    return TensionSeries(cable_names, time_s, recording.trial, at_rest, recording.tensions_n)


def at_rest_without(series: TensionSeries, pulls: Sequence[Pull]) -> NDArray[np.bool_]:
    """(R,) at rest, and neither during a pull nor while the arm then settles."""
    at_rest = series.at_rest.copy()
    for window in (pull.window for pull in pulls):
        at_rest &= ~replace(window, end_s=window.end_s + SETTLING_S).rows(series.time_s)
    return at_rest


@dataclass(frozen=True)
class ChannelStatistics:
    """One sensor; none where there were too few readings at rest.

    Attributes:
        cable: its name.
        mean_n: at rest, or of all readings where there was no rest.
        lowest_n, highest_n: of all readings.
        noise_n: standard deviation at rest about a straight line, the median of windows of 1 s.
        step_n: smallest step of the readings; none where they lie on no steps.
        drift_n: rise of a straight line through the readings at rest from first to last.
    """

    cable: str
    mean_n: float
    lowest_n: float
    highest_n: float
    noise_n: float | None
    step_n: float | None
    drift_n: float | None


def channel_statistics(
    cable: str, time_s: Array, readings_n: Array, at_rest: NDArray[np.bool_]
) -> ChannelStatistics:
    """The statistics of (R,) readings at ascending times, of which some were taken at rest."""
    rest_n, rest_s = readings_n[at_rest], time_s[at_rest]
    enough = len(rest_n) >= WINDOW_SAMPLES
    line = _line(rest_s, rest_n) if enough else None
    return ChannelStatistics(
        cable=cable,
        mean_n=float((rest_n if enough else readings_n).mean()),
        lowest_n=float(readings_n.min()),
        highest_n=float(readings_n.max()),
        noise_n=_noise_n(rest_s, rest_n),
        step_n=quantisation_step_n(readings_n),
        drift_n=None if line is None else float(line[-1] - line[0]),
    )


def quantisation_step_n(readings_n: Array) -> float | None:
    """The step on whose multiples readings (R,) lie, from any start; none if they lie on none.

    It can be a multiple of the true step where no two neighbouring values occur.
    """
    values = np.unique(readings_n)
    if len(values) < FEWEST_VALUES:
        return None
    gaps = np.diff(values)
    whole = np.round(gaps / gaps.min())  # gap by gap, so that rounded values do not add up
    steps = np.concatenate([[0.0], np.cumsum(whole)])
    step_n = float(np.polyfit(steps, values, 1)[0])
    scatter = np.abs(gaps / step_n - whole)
    return step_n if float(scatter.max()) < STEP_SCATTER else None


def _noise_n(time_s: Array, readings_n: Array) -> float | None:
    deviations_n = []
    start = 0
    while start + WINDOW_SAMPLES <= len(time_s):
        end = int(np.searchsorted(time_s, time_s[start] + WINDOW_S))
        end = max(end, start + WINDOW_SAMPLES)
        if end > len(time_s):
            break
        window_n = readings_n[start:end]
        error_n = window_n - _line(time_s[start:end], window_n)
        deviations_n.append(float(np.sqrt((error_n**2).sum() / (len(window_n) - 2))))
        start = end
    return float(np.median(deviations_n)) if deviations_n else None


def _line(time_s: Array, readings_n: Array) -> Array:
    fit = linregress(time_s, readings_n)
    return np.asarray(fit.intercept + fit.slope * time_s, dtype=np.float64)


@dataclass(frozen=True)
class TimingStatistics:
    """Of the samples' stamps, within blocks.

    Attributes:
        samples: how many.
        rate_hz: one over the mean interval between samples of which none is missing between.
        jitter_s: by how much 99 of 100 such intervals differ at most from their median.
        lost: samples that are missing between others, by the length of the intervals.
    """

    samples: int
    rate_hz: float
    jitter_s: float
    lost: int


def timing_statistics(series: TensionSeries) -> TimingStatistics:
    """The timing of a series.

    Raises:
        CommissioningError: too few samples.
    """
    interval_s = np.diff(series.time_s)[np.diff(series.block) == 0]
    if len(interval_s) < FEWEST_INTERVALS:
        raise CommissioningError(
            f"only {len(series.time_s)} samples; at least {FEWEST_INTERVALS + 1} in one stretch "
            "are needed, better ten seconds"
        )
    usual_s = float(np.median(interval_s))
    whole = interval_s < 1.5 * usual_s
    missing = np.round(interval_s[~whole] / usual_s) - 1.0
    return TimingStatistics(
        samples=len(series.time_s),
        rate_hz=1.0 / float(interval_s[whole].mean()),
        jitter_s=float(np.quantile(np.abs(interval_s[whole] - usual_s), 0.99)),
        lost=int(missing.sum()),
    )


class PullVerdict(StrEnum):
    """The result of a pull."""

    RIGHT = "right"
    SWAPPED = "swapped"
    DEAD = "dead"
    UNCLEAR = "unclear"
    TOO_WEAK = "too weak"


@dataclass(frozen=True)
class PullResult:
    """A cable pulled by hand: which channels moved, and the verdict.

    A pull on one cable bends the arm and so moves others as well, hence two are distinguished only
    where one moves clearly more. Pulled sideways between its sensor and the arm, the pulled one
    does.

    Attributes:
        cable: which was pulled.
        moved: the channel that moved most, and `second` the next.
        own_n, moved_n, second_n: by how much the pulled cable's channel and those two moved.
        verdict: the conclusion.
    """

    cable: str
    own_n: float
    moved: str
    moved_n: float
    second: str
    second_n: float
    verdict: PullVerdict


def judge_pull(series: TensionSeries, pull: Pull, floor_n: float) -> PullResult:
    """The result of a pull; `floor_n`: standard deviation of readings at rest, as it should be.

    Raises:
        CommissioningError: too few readings before or during the pull.
    """
    start_s = pull.window.start_s
    before = (series.time_s >= start_s - BEFORE_S) & (series.time_s < start_s)
    during = pull.window.rows(series.time_s)
    if min(np.count_nonzero(before), np.count_nonzero(during)) < FEWEST_SAMPLES:
        raise CommissioningError(
            f"pull of {pull.cable} from {start_s:g} s: {np.count_nonzero(before)} readings in the "
            f"second before and {np.count_nonzero(during)} until {pull.window.end_s:g} s; at "
            f"least {FEWEST_SAMPLES} of each are needed"
        )
    rest_n = np.median(series.tensions_n[before], axis=0)
    # from the median before to what a twentieth of the readings exceed
    moved_n = np.quantile(np.abs(series.tensions_n[during] - rest_n), 0.95, axis=0)
    ranked = np.argsort(moved_n)[::-1]
    first, second = int(ranked[0]), int(ranked[1])
    own = series.cable_names.index(pull.cable)
    if moved_n[first] < PULLED_FLOORS * floor_n:
        verdict = PullVerdict.TOO_WEAK
    elif first == own:
        clear = moved_n[second] <= CLEARLY * moved_n[first]
        verdict = PullVerdict.RIGHT if clear else PullVerdict.UNCLEAR
    elif np.ptp(series.tensions_n[during, own]) == 0.0:
        verdict = PullVerdict.DEAD
    else:
        clear = moved_n[own] <= CLEARLY * moved_n[first]
        verdict = PullVerdict.SWAPPED if clear else PullVerdict.UNCLEAR
    names, by_n = series.cable_names, moved_n.tolist()
    return PullResult(
        pull.cable, by_n[own], names[first], by_n[first], names[second], by_n[second], verdict
    )
