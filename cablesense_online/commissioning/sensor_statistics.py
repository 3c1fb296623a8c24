"""Statistics of tension readings: noise, quantisation step, drift, timing, movement under pulls.

A series of readings comes from a recording or from the live topic. Noise and drift are computed at
rest: static equilibrium in one pose without contact.
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
"""Time for oscillations to decay after a change of pose or load."""
WINDOW_S = 1.0
"""Deviations from a straight line within this window count as noise."""
WINDOW_SAMPLES = 10
"""Minimum number of samples per window."""
FEWEST_VALUES = 3
"""With fewer distinct values, a step cannot be distinguished from chance."""
STEP_SCATTER = 0.1
"""Largest deviation from whole steps, as a share of a step, of quantised readings."""
FEWEST_INTERVALS = 20
"""With fewer intervals, neither rate nor noise can be estimated."""
BEFORE_S = 1.0
"""A pull is compared with the readings of this time before it."""
FEWEST_SAMPLES = 3
CLEARLY = 0.7
"""If the second channel changes by more than this share of the first, a pull is unclear."""
PULLED_FLOORS = 10.0
"""A pull must change a reading by at least this many standard deviations."""


@dataclass(frozen=True)
class TensionSeries:
    """R readings of M sensors in time order.

    Attributes:
        cable_names: (M,).
        time_s: (R,) ascending.
        block: (R,) number of the uninterrupted block that each row belongs to.
        at_rest: (R,) whether the arm was at rest, always in the same pose and without contact.
        tensions_n: (R, M).
        problems: problems found while the readings were received, one line each.
    """

    cable_names: tuple[str, ...]
    time_s: Array
    block: NDArray[np.int64]
    at_rest: NDArray[np.bool_]
    tensions_n: Array
    problems: tuple[str, ...] = ()


def series_of(recording: Recording, cable_names: tuple[str, ...]) -> TensionSeries:
    """A recording's readings; rest is its most frequent unloaded pose, after settling."""
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
    """(R,) rows at rest, without those of pulls and of the settling that follows."""
    at_rest = series.at_rest.copy()
    for window in (pull.window for pull in pulls):
        at_rest &= ~replace(window, end_s=window.end_s + SETTLING_S).rows(series.time_s)
    return at_rest


@dataclass(frozen=True)
class ChannelStatistics:
    """Statistics of one sensor; none if there were too few readings at rest.

    Attributes:
        cable: its name.
        mean_n: at rest, or of all readings if too few are at rest.
        lowest_n, highest_n: of all readings.
        noise_n: standard deviation at rest about a straight line, the median of windows of 1 s.
        step_n: smallest step of the readings; none if they are not quantised.
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
    """Statistics of (R,) readings at ascending times; `at_rest` (R,) marks those at rest."""
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
    """The quantisation step of (R,) readings with any offset; none if they are not quantised.

    It can be a multiple of the true step if no two adjacent levels occur.
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
    """Timing of the samples' stamps, within blocks.

    Attributes:
        samples: how many.
        rate_hz: one over the mean interval between samples, without intervals that span a loss.
        jitter_s: 99 % quantile of the deviation of such intervals from the median.
        lost: number of missing samples, from the length of the intervals.
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

    A pull on one cable deflects the arm and so changes other readings too. The channel is
    identified only if one reading changes clearly more, as it does if the cable is pulled sideways
    between its sensor and the arm.

    Attributes:
        cable: the cable that was pulled.
        moved, second: the channels whose readings changed most and second most.
        own_n, moved_n, second_n: change of the pulled cable's reading and of those two.
        verdict: conclusion from these changes.
    """

    cable: str
    own_n: float
    moved: str
    moved_n: float
    second: str
    second_n: float
    verdict: PullVerdict


def judge_pull(series: TensionSeries, pull: Pull, floor_n: float) -> PullResult:
    """The result of a pull; `floor_n` is the expected standard deviation at rest.

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
    # 95 % quantile, so that single outliers do not count
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
