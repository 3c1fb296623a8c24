"""Whether sensors can be used: figures, what they should be, and what is wrong where.

What readings of good sensors look like: by the arm file, or as a person asks.

Channels beside what the arm file predicts, where a recording has loads or poses to tell by.

What one sensor's readings say of it: noise, quantisation step, drift, range.

How regularly samples come.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cablesense_base.arrays import Array
from cablesense_gap.recordings.checks import Severity, channel_findings
from cablesense_gap.recordings.recording import Recording
from cablesense_online.commissioning.pull_check import (
    PULLED_FLOORS,
    Pull,
    PullResult,
    PullVerdict,
    judge_pull,
)
from cablesense_online.commissioning.readings import CommissioningError, TensionSeries, without
from cablesense_sim.arm import Arm, Sensors
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.sensors import reading_variance_n2

RATE_TOLERANCE = 0.05
JITTER_PERIODS = 0.5
"""From half a period on, a sample can be taken for its neighbour."""
LOST_SHARE = 0.001
NOISE_FACTOR = 2.0
"""Over what the arm file says; a loose screen or a motor nearby makes far more."""
STEP_FACTOR = 1.5
LEAST_FLOOR_N = 0.01
"""Of an arm file whose sensors are ideal."""
DRIFT_FLOORS = 4.0
"""So many standard deviations of a reading are noticed as a force by and by."""


@dataclass(frozen=True)
class SensorExpectation:
    """Bounds beside each figure.

    Attributes:
        rate_hz: of samples, to 5 %.
        floor_n: standard deviation of one reading at rest: noise, and the step's rounding.
        noise_n, step_n, drift_n: the most that is right; a step of 0 is not looked at.
        range_n: the ends at which a reading means nothing; none where unknown.
    """

    rate_hz: float
    floor_n: float
    noise_n: float
    step_n: float
    drift_n: float
    range_n: tuple[float, float] | None

    @property
    def jitter_s(self) -> float:
        """The most that is right."""
        return JITTER_PERIODS / self.rate_hz


def expectation(
    sensors: Sensors, rate_hz: float | None = None, drift_n: float | None = None
) -> SensorExpectation:
    """What an arm file expects of its sensors; rate and drift can be given instead."""
    floor_n = max(float(np.sqrt(reading_variance_n2(sensors))), LEAST_FLOOR_N)
    return SensorExpectation(
        rate_hz=sensors.rate_hz if rate_hz is None else rate_hz,
        floor_n=floor_n,
        noise_n=NOISE_FACTOR * floor_n,
        step_n=STEP_FACTOR * sensors.step_n,
        drift_n=DRIFT_FLOORS * floor_n if drift_n is None else drift_n,
        range_n=sensors.range_n,
    )


WINDOW_S = 1.0
"""Within it what changes by more than a straight line counts as noise."""
WINDOW_SAMPLES = 10
"""A window has at least so many."""
FEWEST_VALUES = 3
"""Different values without which no step can be told from chance."""
STEP_SCATTER = 0.1
"""Values further than this share of a step from whole steps are not on steps."""


@dataclass(frozen=True)
class ChannelFigures:
    """One sensor; none where there were too few readings at rest.

    Attributes:
        cable: its name.
        mean_n: at rest, or of all readings where there was no rest.
        lowest_n, highest_n: of all readings.
        noise_n: standard deviation at rest about a straight line, the median of windows of 1 s.
        step_n: smallest step of the readings; none where they lie on no steps.
        drift_n: what a straight line through the readings at rest rises by from first to last.
    """

    cable: str
    mean_n: float
    lowest_n: float
    highest_n: float
    noise_n: float | None
    step_n: float | None
    drift_n: float | None


def channel_figures(
    cable: str, time_s: Array, readings_n: Array, at_rest: NDArray[np.bool_]
) -> ChannelFigures:
    """The figures of (R,) readings at ascending times, of which some were taken at rest."""
    rest_n, rest_s = readings_n[at_rest], time_s[at_rest]
    enough = len(rest_n) >= WINDOW_SAMPLES
    return ChannelFigures(
        cable=cable,
        mean_n=float((rest_n if enough else readings_n).mean()),
        lowest_n=float(readings_n.min()),
        highest_n=float(readings_n.max()),
        noise_n=_noise_n(rest_s, rest_n),
        step_n=quantisation_step_n(readings_n),
        drift_n=_drift_n(rest_s, rest_n) if enough else None,
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


def _drift_n(time_s: Array, readings_n: Array) -> float:
    line = _line(time_s, readings_n)
    return float(line[-1] - line[0])


def _line(time_s: Array, readings_n: Array) -> Array:
    since_s = time_s - time_s.mean()
    slope = float((since_s * readings_n).sum() / (since_s**2).sum())
    return np.asarray(readings_n.mean() + slope * since_s, dtype=np.float64)


FEWEST_SAMPLES = 20
"""With fewer, neither a rate nor noise can be told."""


@dataclass(frozen=True)
class TimingFigures:
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

    @property
    def lost_share(self) -> float:
        """Of all that there should be."""
        return self.lost / (self.samples + self.lost)


def timing_figures(series: TensionSeries) -> TimingFigures:
    """The figures of a series.

    Raises:
        CommissioningError: too few samples.
    """
    interval_s = np.diff(series.time_s)[np.diff(series.block) == 0]
    if len(interval_s) < FEWEST_SAMPLES:
        raise CommissioningError(
            f"only {len(series.time_s)} samples; at least {FEWEST_SAMPLES + 1} in one stretch are "
            "needed, better ten seconds"
        )
    usual_s = float(np.median(interval_s))
    whole = interval_s < 1.5 * usual_s
    missing = np.round(interval_s[~whole] / usual_s) - 1.0
    return TimingFigures(
        samples=len(series.time_s),
        rate_hz=1.0 / float(interval_s[whole].mean()),
        jitter_s=float(np.quantile(np.abs(interval_s[whole] - usual_s), 0.99)),
        lost=int(missing.sum()),
    )


MOVED_FLOORS = 20.0
"""A channel that moves by so many standard deviations of a reading is alive."""


@dataclass(frozen=True)
class SensorFinding:
    """One thing to know.

    Attributes:
        wrong: whether the sensors cannot be used as they are.
        kind: one word for programs.
        where: the cable, or `all`.
        text: what, and what would be right.
    """

    wrong: bool
    kind: str
    where: str
    text: str


@dataclass(frozen=True)
class SensorReport:
    """Figures of all sensors, and the findings, what is wrong first."""

    timing: TimingFigures
    channels: tuple[ChannelFigures, ...]
    pulls: tuple[PullResult, ...]
    findings: tuple[SensorFinding, ...]

    @property
    def usable(self) -> bool:
        """Whether nothing is wrong."""
        return not any(finding.wrong for finding in self.findings)


def check_sensors(
    series: TensionSeries, expected: SensorExpectation, pulls: Sequence[Pull] = ()
) -> SensorReport:
    """Look at a series of readings; while a cable was pulled the arm was not at rest.

    Raises:
        CommissioningError: too few readings, in all or around a pull.
    """
    timing = timing_figures(series)
    results = tuple(judge_pull(series, pull, expected.floor_n) for pull in pulls)
    resting = series
    for pull in pulls:
        at_rest = without(resting, pull.window.start_s, pull.window.end_s)
        resting = replace(resting, at_rest=at_rest)
    channels = tuple(
        channel_figures(cable, series.time_s, readings_n, resting.at_rest)
        for cable, readings_n in zip(series.cable_names, series.tensions_n.T, strict=True)
    )
    findings = [SensorFinding(True, "samples", "all", line) for line in series.problems]
    findings += _of_timing(timing, expected)
    for channel in channels:
        findings += _of_channel(channel, expected)
        findings += _of_drift(channel, expected, alone=bool(resting.at_rest.all()))
    findings += _of_standstill(series, expected)
    for result in results:
        findings += _of_pull(result, expected)
    findings.sort(key=lambda finding: not finding.wrong)
    return SensorReport(timing, channels, results, tuple(findings))


def _of_timing(timing: TimingFigures, expected: SensorExpectation) -> Iterator[SensorFinding]:
    if abs(timing.rate_hz - expected.rate_hz) > RATE_TOLERANCE * expected.rate_hz:
        yield SensorFinding(
            True,
            "rate",
            "all",
            f"samples come at {timing.rate_hz:.1f} Hz; {expected.rate_hz:g} Hz would be right: "
            "set the amplifier, or give --rate",
        )
    if timing.jitter_s > expected.jitter_s:
        yield SensorFinding(
            True,
            "jitter",
            "all",
            f"intervals differ by {1e3 * timing.jitter_s:.2f} ms; at most "
            f"{1e3 * expected.jitter_s:.2f} ms would be right: see adapter and load of the "
            "machine",
        )
    if timing.lost_share > LOST_SHARE:
        yield SensorFinding(
            True,
            "lost",
            "all",
            f"{timing.lost} of {timing.samples + timing.lost} samples are missing; at most one "
            "in a thousand would be right: the driver's diagnostics say why",
        )


def _of_channel(channel: ChannelFigures, expected: SensorExpectation) -> Iterator[SensorFinding]:
    def wrong(kind: str, text: str) -> SensorFinding:
        return SensorFinding(True, kind, channel.cable, text)

    if channel.noise_n is None:
        yield SensorFinding(
            False,
            "rest",
            channel.cable,
            "too few readings at rest for noise and drift; leave the arm alone for ten seconds",
        )
    elif channel.noise_n > expected.noise_n:
        yield wrong(
            "noise",
            f"varies by {channel.noise_n:.3f} N at rest; at most {expected.noise_n:.3f} N would "
            "be right: see screen and ground, and that nothing moves the arm",
        )
    if expected.step_n and channel.step_n is not None and channel.step_n > expected.step_n:
        yield wrong(
            "step",
            f"reads in steps of {channel.step_n:.3f} N; at most {expected.step_n:.3f} N would be "
            "right: see the amplifier's range and the DBC file's factor",
        )
    if expected.range_n is not None:
        low, high = expected.range_n
        if channel.lowest_n <= low or channel.highest_n >= high:
            yield wrong(
                "range",
                f"reads {channel.lowest_n:.1f} to {channel.highest_n:.1f} N, to an end of its "
                f"range; within {low:g} to {high:g} N would be right: see that it is connected",
            )


def _of_drift(
    channel: ChannelFigures, expected: SensorExpectation, alone: bool
) -> Iterator[SensorFinding]:
    """Only of an arm that was left `alone` it is wrong: friction keeps part of what moved it."""
    if channel.drift_n is None or abs(channel.drift_n) <= expected.drift_n:
        return
    remedy = (
        "let sensors warm up and cables creep, then check again"
        if alone
        else "friction and creep do that after loads, moves and pulls; check an arm left alone"
    )
    text = (
        f"went by {channel.drift_n:+.2f} N at rest; at most {expected.drift_n:.2f} N would be "
        f"right: {remedy}"
    )
    yield SensorFinding(alone, "drift", channel.cable, text)


def _of_standstill(series: TensionSeries, expected: SensorExpectation) -> Iterator[SensorFinding]:
    moved_n = np.ptp(series.tensions_n, axis=0)
    others_moved = np.count_nonzero(moved_n > MOVED_FLOORS * expected.floor_n)
    told = bool(2 * others_moved >= len(moved_n))
    for cable in np.flatnonzero(moved_n == 0.0):
        value_n = series.tensions_n[0, cable]
        text = (
            f"stands at {value_n:.2f} N to the last bit while others move; see its plug and sensor"
            if told
            else f"stands at {value_n:.2f} N to the last bit; at rest that can be, so pull it by "
            "hand (--pull) to see it move"
        )
        yield SensorFinding(told, "stuck", series.cable_names[cable], text)


def _of_pull(result: PullResult, expected: SensorExpectation) -> Iterator[SensorFinding]:
    moved = f"{result.moved} moved most ({result.moved_n:.1f} N)"
    own = f"{result.cable} by {result.own_n:.1f} N"
    if result.verdict is PullVerdict.SWAPPED:
        text = (
            f"was pulled, but {moved}, {own}; its own would be right: exchange plugs, or the map"
        )
        yield SensorFinding(True, "swapped", result.cable, text)
    elif result.verdict is PullVerdict.DEAD:
        text = f"was pulled and stood still, while {moved}; see its plug and sensor"
        yield SensorFinding(True, "stuck", result.cable, text)
    elif result.verdict is PullVerdict.UNCLEAR:
        text = (
            f"was pulled: {moved}, {result.second} hardly less ({result.second_n:.1f} N); pull "
            "this cable alone, sideways, near its sensor"
        )
        yield SensorFinding(False, "pull", result.cable, text)
    elif result.verdict is PullVerdict.TOO_WEAK:
        text = (
            f"was pulled, but no channel moved by more than {result.moved_n:.2f} N; at least "
            f"{PULLED_FLOORS * expected.floor_n:.1f} N is needed: pull harder, in the time given"
        )
        yield SensorFinding(False, "pull", result.cable, text)


MOST_ROWS = 20_000
"""Predicted within a second or two; longer recordings are thinned out."""

_KINDS = ("swapped", "stuck", "arm", "unit")
"""The others are told by the sensors' own figures."""


def exercised_channel_findings(recording: Recording, arm: Arm) -> list[SensorFinding]:
    """Exchanged or dead channels and wrong units, by the nominal arm; empty without movement.

    Raises:
        CableSenseError: the arm has no rest under one of the loads.
    """
    if not (np.ptp(recording.command_rad, axis=0).any() or recording.load_n.any()):
        return []
    every = -(-len(recording) // MOST_ROWS)
    recording = recording.rows(slice(None, None, every))
    nominal = solve_equilibrium(mechanism_of(arm), recording.command_rad, recording.forces_n)
    counted = f" (rows count one sample in {every})" if every > 1 else ""
    return [
        SensorFinding(True, finding.kind, "all", finding.text + counted)
        for finding in channel_findings(recording, arm, nominal.tensions_n)
        if finding.kind in _KINDS or finding.severity is Severity.REFUSE
    ]
