"""Check of tension sensors: compare their statistics with the expected ones and report findings.

The expected statistics come from the arm file or from options. If the recording has loads or
moves, channels are also compared with the nominal arm's tensions.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from cablesense_gap.recordings.channels import Severity, channel_findings
from cablesense_gap.recordings.recording import Recording
from cablesense_gap.recordings.thinning import rows_to_use
from cablesense_online.commissioning.sensor_statistics import (
    PULLED_FLOORS,
    ChannelStatistics,
    PullResult,
    PullVerdict,
    TensionSeries,
    TimingStatistics,
    at_rest_without,
    channel_statistics,
    judge_pull,
    timing_statistics,
)
from cablesense_online.commissioning.tables import Pull
from cablesense_sim.arm import Arm, Sensors
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.replay import reading_variance_n2

RATE_TOLERANCE = 0.05
JITTER_PERIODS = 0.5
"""With more than half a period, a sample can be mistaken for its neighbour."""
LOST_SHARE = 0.001
NOISE_FACTOR = 2.0
"""Relative to the arm file; a loose screen or a nearby motor causes far more noise."""
STEP_FACTOR = 1.5
LEAST_FLOOR_N = 0.01
"""Floor for an arm file with ideal sensors; real sensors have at least this noise."""
DRIFT_FLOORS = 4.0
"""A larger drift, in standard deviations of a reading, is soon estimated as a force."""


@dataclass(frozen=True)
class SensorExpectation:
    """Bounds of each statistic; upper limits unless stated otherwise.

    Attributes:
        rate_hz: sample rate, within 5 %.
        floor_n: standard deviation of one reading at rest: noise, and the step's rounding.
        step_n: 0 means not checked.
        range_n: ends of the measuring range, where readings are invalid; none if unknown.
    """

    rate_hz: float
    floor_n: float
    noise_n: float
    step_n: float
    drift_n: float
    range_n: tuple[float, float] | None

    @property
    def jitter_s(self) -> float:
        """Upper limit of the jitter."""
        return JITTER_PERIODS / self.rate_hz


def expectation(
    sensors: Sensors, rate_hz: float | None = None, drift_n: float | None = None
) -> SensorExpectation:
    """The expectation from an arm file; a given rate or drift takes precedence."""
    floor_n = max(float(np.sqrt(reading_variance_n2(sensors))), LEAST_FLOOR_N)
    return SensorExpectation(
        rate_hz=sensors.rate_hz if rate_hz is None else rate_hz,
        floor_n=floor_n,
        noise_n=NOISE_FACTOR * floor_n,
        step_n=STEP_FACTOR * sensors.step_n,
        drift_n=DRIFT_FLOORS * floor_n if drift_n is None else drift_n,
        range_n=sensors.range_n,
    )


MOVED_FLOORS = 20.0
"""A channel that moves by this many standard deviations of a reading works."""


@dataclass(frozen=True)
class SensorFinding:
    """One problem, or one note.

    Attributes:
        wrong: whether the sensors cannot be used as they are.
        kind: one word for programs.
        where: the cable, or `all`.
        text: the problem, and what would be right.
    """

    wrong: bool
    kind: str
    where: str
    text: str


_Findings = Iterator[SensorFinding]


@dataclass(frozen=True)
class SensorReport:
    """Statistics of all sensors, and the findings, those that are wrong first."""

    timing: TimingStatistics
    channels: tuple[ChannelStatistics, ...]
    pulls: tuple[PullResult, ...]
    findings: tuple[SensorFinding, ...]

    @property
    def usable(self) -> bool:
        """Whether nothing is wrong."""
        return not any(finding.wrong for finding in self.findings)


def check_sensors(
    series: TensionSeries, expected: SensorExpectation, pulls: Sequence[Pull] = ()
) -> SensorReport:
    """Check a series of readings; times of pulls do not count as rest.

    Raises:
        CommissioningError: too few readings, overall or around a pull.
    """
    timing = timing_statistics(series)
    results = tuple(judge_pull(series, pull, expected.floor_n) for pull in pulls)
    at_rest = at_rest_without(series, pulls)
    channels = tuple(
        channel_statistics(cable, series.time_s, readings_n, at_rest)
        for cable, readings_n in zip(series.cable_names, series.tensions_n.T, strict=True)
    )
    findings = [SensorFinding(True, "samples", "all", line) for line in series.problems]
    findings += _of_timing(timing, expected)
    for channel in channels:
        findings += _of_channel(channel, expected, alone=bool(at_rest.all()))
    findings += _of_standstill(series, expected)
    for result in results:
        findings += _of_pull(result, expected)
    findings.sort(key=lambda finding: not finding.wrong)
    return SensorReport(timing, channels, results, tuple(findings))


def _of_timing(timing: TimingStatistics, expected: SensorExpectation) -> _Findings:
    for exceeded, kind, text in (
        (
            abs(timing.rate_hz - expected.rate_hz) > RATE_TOLERANCE * expected.rate_hz,
            "rate",
            f"samples come at {timing.rate_hz:.1f} Hz; {expected.rate_hz:g} Hz would be right: "
            "set the amplifier, or give --rate",
        ),
        (
            timing.jitter_s > expected.jitter_s,
            "jitter",
            f"intervals differ by {1e3 * timing.jitter_s:.2f} ms; at most "
            f"{1e3 * expected.jitter_s:.2f} ms would be right: check adapter and load of the "
            "machine",
        ),
        (
            timing.lost > LOST_SHARE * (timing.samples + timing.lost),
            "lost",
            f"{timing.lost} of {timing.samples + timing.lost} samples are missing; at most one "
            "in a thousand would be right: the driver's diagnostics give the cause",
        ),
    ):
        if exceeded:
            yield SensorFinding(True, kind, "all", text)


def _of_channel(channel: ChannelStatistics, expected: SensorExpectation, alone: bool) -> _Findings:
    """Drift is wrong only for an arm left `alone`: after motion, friction and creep cause it."""
    wrong = partial(SensorFinding, True, where=channel.cable)
    note = partial(SensorFinding, False, where=channel.cable)
    if channel.noise_n is None:
        text = "too few readings at rest for noise and drift; leave the arm alone for ten seconds"
        yield note("rest", text=text)
    elif channel.noise_n > expected.noise_n:
        text = (
            f"varies by {channel.noise_n:.3f} N at rest; at most {expected.noise_n:.3f} N would "
            "be right: check screen and ground, and that nothing moves the arm"
        )
        yield wrong("noise", text=text)
    if expected.step_n and channel.step_n is not None and channel.step_n > expected.step_n:
        text = (
            f"reads in steps of {channel.step_n:.3f} N; at most {expected.step_n:.3f} N would be "
            "right: check the amplifier's range and the DBC file's factor"
        )
        yield wrong("step", text=text)
    low, high = expected.range_n or (float("-inf"), float("inf"))
    if channel.lowest_n <= low or channel.highest_n >= high:
        text = (
            f"reads {channel.lowest_n:.1f} to {channel.highest_n:.1f} N, to an end of its range; "
            f"within {low:g} to {high:g} N would be right: check that it is connected"
        )
        yield wrong("range", text=text)
    if channel.drift_n is not None and abs(channel.drift_n) > expected.drift_n:
        remedy = (
            "let sensors warm up and cables creep, then check again"
            if alone
            else "friction and creep do that after loads, moves and pulls; check an arm left alone"
        )
        text = (
            f"went by {channel.drift_n:+.2f} N at rest; at most {expected.drift_n:.2f} N would be "
            f"right: {remedy}"
        )
        yield (wrong if alone else note)("drift", text=text)


def _of_standstill(series: TensionSeries, expected: SensorExpectation) -> _Findings:
    moved_n = np.ptp(series.tensions_n, axis=0)
    others_moved = np.count_nonzero(moved_n > MOVED_FLOORS * expected.floor_n)
    certain = bool(2 * others_moved >= len(moved_n))
    remedy = (
        " while others move; check plug and sensor"
        if certain
        else "; at rest that can be, so pull it by hand (--pull) to see it move"
    )
    for cable in np.flatnonzero(moved_n == 0.0):
        text = f"stands at {series.tensions_n[0, cable]:.2f} N to the last bit{remedy}"
        yield SensorFinding(certain, "stuck", series.cable_names[cable], text)


def _of_pull(result: PullResult, expected: SensorExpectation) -> _Findings:
    moved = f"{result.moved} moved most ({result.moved_n:.1f} N)"
    wrong, kind, text = {
        PullVerdict.RIGHT: (False, "", ""),
        PullVerdict.SWAPPED: (
            True,
            "swapped",
            f"was pulled, but {moved}, {result.cable} by {result.own_n:.1f} N; its own would be "
            "right: exchange plugs, or the map",
        ),
        PullVerdict.DEAD: (
            True,
            "stuck",
            f"was pulled and stood still, while {moved}; check its plug and sensor",
        ),
        PullVerdict.UNCLEAR: (
            False,
            "pull",
            f"was pulled: {moved}, {result.second} hardly less ({result.second_n:.1f} N); pull "
            "this cable alone, sideways, near its sensor",
        ),
        PullVerdict.TOO_WEAK: (
            False,
            "pull",
            f"was pulled, but no channel moved by more than {result.moved_n:.2f} N; at least "
            f"{PULLED_FLOORS * expected.floor_n:.1f} N is needed: pull harder, in the time given",
        ),
    }[result.verdict]
    if kind:
        yield SensorFinding(wrong, kind, result.cable, text)


_KINDS = ("swapped", "stuck", "arm", "unit")
"""Other kinds already appear in the statistics of the sensors."""


def exercised_channel_findings(recording: Recording, arm: Arm) -> list[SensorFinding]:
    """Swapped or dead channels and wrong units against the nominal arm; empty without motion.

    Raises:
        CableSenseError: the arm has no equilibrium under one of the loads.
    """
    if not (np.ptp(recording.command_rad, axis=0).any() or recording.load_n.any()):
        return []
    rows = rows_to_use(recording)
    used = recording.rows(rows)
    nominal = solve_equilibrium(mechanism_of(arm), used.command_rad, used.forces_n)
    return [
        SensorFinding(True, finding.kind, "all", finding.text)
        for finding in channel_findings(recording, arm, nominal.tensions_n, rows)
        if finding.kind in _KINDS or finding.severity is Severity.REFUSE
    ]
