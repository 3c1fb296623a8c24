"""Whether sensors can be used: figures, what they should be, and what is wrong where."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cablesense_ros.commissioning.channel_figures import ChannelFigures, channel_figures
from cablesense_ros.commissioning.pull_check import (
    PULLED_FLOORS,
    Pull,
    PullResult,
    PullVerdict,
    judge_pull,
)
from cablesense_ros.commissioning.sensor_expectation import (
    LOST_SHARE,
    RATE_TOLERANCE,
    SensorExpectation,
)
from cablesense_ros.commissioning.tension_series import TensionSeries, without
from cablesense_ros.commissioning.timing_figures import TimingFigures, timing_figures

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
