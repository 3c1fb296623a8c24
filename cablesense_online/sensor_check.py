"""Check of tension sensors: noise, step, drift, timing and pulls, against the expected values.

Noise and drift are computed at rest: static equilibrium in one pose without contact.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import detrend

from cablesense_base import Array, CableSenseError
from cablesense_recording.recording import Recording
from cablesense_sim.arm import Sensors
from cablesense_sim.replay import reading_variance_n2

SETTLING_S = 1.0
"""Time for oscillations to decay after a change of pose or load."""
WINDOW_S = 1.0
"""Deviations from a straight line within this window count as noise."""
WINDOW_SAMPLES = 10
"""Minimum number of samples per window."""
STEP_SCATTER = 0.1
"""Largest deviation from whole steps, as a share of a step, of quantised readings."""
FEWEST_INTERVALS = 20
"""With fewer intervals, neither rate nor noise can be estimated."""
BEFORE_S = 1.0
"""A pull is compared with the readings of this time before it."""
FEWEST_SAMPLES = 3
"""Before a pull and in it, for a mean of each."""
CLEARLY = 0.7
"""If the second channel changes by more than this share of the first, a pull is unclear."""
PULLED_FLOORS = 10.0
"""A pull must change a reading by at least this many standard deviations."""
MOVED_FLOORS = 20.0
"""A channel that moves by this many standard deviations of a reading works."""
RATE_TOLERANCE = 0.05
"""Share by which the rate may differ from the one stated."""
JITTER_PERIODS = 0.5
"""With more than half a period, a sample can be mistaken for its neighbour."""
LOST_SHARE = 0.001
"""Share of the samples that may be lost."""
NOISE_FACTOR = 2.0
"""Times the noise of the arm file that a sensor's may be; a loose screen or a nearby motor causes
far more."""
STEP_FACTOR = 1.5
"""Times the step of the arm file that a converter's step may be."""
LEAST_FLOOR_N = 0.01
"""Floor for an arm file with ideal sensors; real sensors have at least this noise."""
DRIFT_FLOORS = 4.0
"""A larger drift, in standard deviations of a reading, is soon estimated as a force."""


class CommissioningError(CableSenseError):
    """Unusable input for commissioning; the message names file, row or cable, and the remedy."""


def rows_at_rest(recording: Recording) -> NDArray[np.bool_]:
    """(R,) the rows of the most frequent pose without load, after settling."""
    at_rest = recording.load_segment == 0
    time_s = recording.time_s
    if at_rest.any():
        _, pose = np.unique(recording.command_rad, axis=0, return_inverse=True)
        pose = pose.reshape(-1)
        at_rest &= pose == np.bincount(pose[at_rest]).argmax()
    for start_s in time_s[1:][np.diff(at_rest.astype(int)) == 1].tolist():
        at_rest &= (time_s < start_s) | (time_s >= start_s + SETTLING_S)
    return at_rest


@dataclass(frozen=True)
class ChannelStatistics:
    """Statistics of one sensor; none if there were too few readings at rest.

    Attributes:
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
    recording: Recording, cable_names: Sequence[str], at_rest: NDArray[np.bool_], rate_hz: float
) -> tuple[ChannelStatistics, ...]:
    """Statistics of every sensor; `at_rest` (R,) marks the readings at rest."""
    read_n = recording.tensions_n
    rest_s = recording.time_s[at_rest]
    rest_n = read_n[at_rest]
    enough = len(rest_n) >= WINDOW_SAMPLES
    noise_n = read_n.mean(axis=0)
    drift_n = noise_n
    mean_n = noise_n
    if enough:
        size = min(max(WINDOW_SAMPLES, round(WINDOW_S * rate_hz)), len(rest_n))
        windows = rest_n[: len(rest_n) // size * size].reshape(-1, size, rest_n.shape[1])
        variance_n2 = (detrend(windows, axis=1) ** 2).sum(axis=1) / (size - 2)
        noise_n = np.sqrt(np.median(variance_n2, axis=0))
        since_s = rest_s - rest_s[0]
        drift_n = np.polyfit(since_s, rest_n, 1)[0] * since_s[-1]
        mean_n = rest_n.mean(axis=0)
    return tuple(
        ChannelStatistics(
            cable=cable,
            mean_n=float(mean_n[channel]),
            lowest_n=float(read_n[:, channel].min()),
            highest_n=float(read_n[:, channel].max()),
            noise_n=float(noise_n[channel]) if enough else None,
            step_n=quantisation_step_n(read_n[:, channel]),
            drift_n=float(drift_n[channel]) if enough else None,
        )
        for channel, cable in enumerate(cable_names)
    )


def quantisation_step_n(readings_n: Array) -> float | None:
    """The quantisation step of (R,) readings with any offset; none if they are not quantised.

    It can be a multiple of the true step if no two adjacent levels occur.
    """
    gaps = np.diff(np.unique(readings_n))
    if len(gaps) < 2:
        return None
    whole = np.round(gaps / gaps.min())
    step_n = float(gaps.sum() / whole.sum())
    scatter = np.abs(gaps / step_n - whole)
    return step_n if float(scatter.max()) < STEP_SCATTER else None


@dataclass(frozen=True)
class TimingStatistics:
    """Timing of the samples' stamps, within trials.

    Attributes:
        rate_hz: one over the mean interval between samples, without intervals that span a loss.
        jitter_s: 99 % quantile of the deviation of such intervals from the median.
        lost: number of missing samples, from the length of the intervals.
    """

    samples: int
    rate_hz: float
    jitter_s: float
    lost: int


def timing_statistics(recording: Recording) -> TimingStatistics:
    """The timing of a recording.

    Raises:
        CommissioningError: too few samples.
    """
    interval_s = np.diff(recording.time_s)[np.diff(recording.trial) == 0]
    if len(interval_s) < FEWEST_INTERVALS:
        raise CommissioningError(
            f"only {len(recording)} samples; at least {FEWEST_INTERVALS + 1} without a break "
            "are needed, better ten seconds"
        )
    usual_s = float(np.median(interval_s))
    whole = interval_s < 1.5 * usual_s
    missing = np.round(interval_s[~whole] / usual_s) - 1.0
    return TimingStatistics(
        samples=len(recording),
        rate_hz=1.0 / float(interval_s[whole].mean()),
        jitter_s=float(np.quantile(np.abs(interval_s[whole] - usual_s), 0.99)),
        lost=int(missing.sum()),
    )


@dataclass(frozen=True)
class Pull:
    """Which cable was pulled, and when."""

    cable: str
    start_s: float
    end_s: float


@dataclass(frozen=True)
class PullResult:
    """A cable pulled by hand: which channel moved most, and the verdict.

    A pull on one cable deflects the arm and so changes other readings too. The channel is
    identified only if one reading changes clearly more, as it does if the cable is pulled sideways
    between its sensor and the arm.

    Attributes:
        own_n: change of the pulled cable's reading.
        moved, moved_n: the channel whose reading changed most, and its change.
        verdict: `right`, `swapped`, `dead`, `unclear` or `too weak`.
    """

    cable: str
    own_n: float
    moved: str
    moved_n: float
    verdict: str


_OF_PULLS = {
    "swapped": (True, "swapped", "exchange plugs, or the map"),
    "dead": (True, "stuck", "it stood still, so check its plug and sensor"),
    "unclear": (False, "pull", "another moved hardly less; pull it alone, at its sensor"),
    "too weak": (False, "pull", "that is too little; pull harder, in the time given"),
}
"""Whether a verdict means wrong sensors, its kind for programs, and the remedy."""


def judge_pull(
    recording: Recording, cable_names: Sequence[str], pull: Pull, floor_n: float
) -> PullResult:
    """The result of a pull; `floor_n` is the expected standard deviation at rest.

    Raises:
        CommissioningError: too few readings before or during the pull.
    """
    time_s = recording.time_s
    read_n = recording.tensions_n
    before = (time_s >= pull.start_s - BEFORE_S) & (time_s < pull.start_s)
    during = (time_s >= pull.start_s) & (time_s <= pull.end_s)
    if min(before.sum(), during.sum()) < FEWEST_SAMPLES:
        raise CommissioningError(
            f"pull of {pull.cable} from {pull.start_s:g} to {pull.end_s:g} s: {before.sum()} "
            f"readings in the second before and {during.sum()} in it; at least {FEWEST_SAMPLES} "
            "of each are needed"
        )
    rest_n = np.median(read_n[before], axis=0)
    # 95 % quantile, so that single outliers do not count
    moved_n = np.quantile(np.abs(read_n[during] - rest_n), 0.95, axis=0)
    second, first = np.argsort(moved_n)[-2:].tolist()
    pulled = cable_names.index(pull.cable)
    rival = second if first == pulled else pulled
    if moved_n[first] < PULLED_FLOORS * floor_n:
        verdict = "too weak"
    elif first != pulled and np.ptp(read_n[during, pulled]) == 0.0:
        verdict = "dead"
    elif moved_n[rival] > CLEARLY * moved_n[first]:
        verdict = "unclear"
    else:
        verdict = "right" if first == pulled else "swapped"
    return PullResult(
        pull.cable, float(moved_n[pulled]), cable_names[first], float(moved_n[first]), verdict
    )


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


def expectation(sensors: Sensors, rate_hz: float | None = None) -> SensorExpectation:
    """The expectation from an arm file; a given rate takes precedence."""
    floor_n = max(float(np.sqrt(reading_variance_n2(sensors))), LEAST_FLOOR_N)
    return SensorExpectation(
        rate_hz=sensors.rate_hz if rate_hz is None else rate_hz,
        floor_n=floor_n,
        noise_n=NOISE_FACTOR * floor_n,
        step_n=STEP_FACTOR * sensors.step_n,
        drift_n=DRIFT_FLOORS * floor_n,
        range_n=sensors.range_n,
    )


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
    recording: Recording,
    cable_names: Sequence[str],
    expected: SensorExpectation,
    pulls: Sequence[Pull] = (),
) -> SensorReport:
    """Check readings of these cables; pulls, and the settling after them, do not count as rest."""
    timing = timing_statistics(recording)
    time_s = recording.time_s
    results = tuple(judge_pull(recording, cable_names, pull, expected.floor_n) for pull in pulls)
    at_rest = rows_at_rest(recording)
    for pull in pulls:
        settled_s = pull.end_s + SETTLING_S
        at_rest &= (time_s < pull.start_s) | (time_s > settled_s)
    channels = channel_statistics(recording, cable_names, at_rest, timing.rate_hz)
    findings = list(_timing_findings(timing, expected))
    moved_n = np.ptp(recording.tensions_n, axis=0)
    others_move = 2 * np.count_nonzero(moved_n > MOVED_FLOORS * expected.floor_n) >= len(moved_n)
    for channel in channels:
        findings += _channel_findings(channel, expected, bool(at_rest.all()), bool(others_move))
    for result in results:
        if result.verdict in _OF_PULLS:
            wrong, kind, remedy = _OF_PULLS[result.verdict]
            text = f"was pulled: {result.moved} moved most ({result.moved_n:.1f} N), "
            text += f"{result.cable} by {result.own_n:.1f} N: {remedy}"
            findings.append(SensorFinding(wrong, kind, result.cable, text))
    findings.sort(key=lambda finding: not finding.wrong)
    return SensorReport(timing, channels, results, tuple(findings))


def _timing_findings(
    timing: TimingStatistics, expected: SensorExpectation
) -> Iterator[SensorFinding]:
    if abs(timing.rate_hz - expected.rate_hz) > RATE_TOLERANCE * expected.rate_hz:
        text = f"samples come at {timing.rate_hz:.1f} Hz, not at {expected.rate_hz:g} Hz"
        yield SensorFinding(True, "rate", "all", f"{text}: set the amplifier, or give --rate")
    if timing.jitter_s > expected.jitter_s:
        text = f"intervals differ by {1e3 * timing.jitter_s:.2f} ms, by more than "
        text += f"{1e3 * expected.jitter_s:.2f} ms: check adapter and load of the machine"
        yield SensorFinding(True, "jitter", "all", text)
    sent = timing.samples + timing.lost
    if timing.lost > LOST_SHARE * sent:
        text = f"{timing.lost} of {sent} samples are missing, more than one in a thousand: the "
        yield SensorFinding(True, "lost", "all", text + "driver's diagnostics give the cause")


_LIMITED = {
    "noise": ("varies at rest by", "check screen and ground, and that nothing moves the arm"),
    "step": ("reads in steps of", "check the amplifier's range and the DBC file's factor"),
    "drift": ("went at rest by", "let sensors warm up, leave the arm alone and check again"),
}
"""Meaning of a statistic above its limit, and the remedy."""


def _channel_findings(
    channel: ChannelStatistics, expected: SensorExpectation, alone: bool, others_move: bool
) -> Iterator[SensorFinding]:
    """Drift is wrong only for an arm left `alone`: after motion, friction and creep cause it."""
    cable = channel.cable
    if channel.noise_n is None:
        text = "too few readings at rest for noise and drift; leave the arm alone for ten seconds"
        yield SensorFinding(False, "rest", cable, text)
    for kind, value_n, limit_n in (
        ("noise", channel.noise_n, expected.noise_n),
        ("step", channel.step_n, expected.step_n),
        ("drift", channel.drift_n, expected.drift_n),
    ):
        if value_n is not None and limit_n and abs(value_n) > limit_n:
            what, remedy = _LIMITED[kind]
            text = f"{what} {value_n:.3f} N, more than {limit_n:.3f} N: {remedy}"
            yield SensorFinding(alone or kind != "drift", kind, cable, text)
    low, high = expected.range_n or (float("-inf"), float("inf"))
    if channel.lowest_n <= low or channel.highest_n >= high:
        text = f"reads {channel.lowest_n:.1f} to {channel.highest_n:.1f} N, to an end of its range"
        text += f" {low:g} to {high:g} N: check that it is connected"
        yield SensorFinding(True, "range", cable, text)
    if channel.lowest_n == channel.highest_n:
        text = f"stands at {channel.mean_n:.2f} N to the last bit"
        moving = " while others move; check plug and sensor"
        resting = "; pull it to see it move"
        yield SensorFinding(
            others_move, "stuck", cable, text + (moving if others_move else resting)
        )
