"""A recording read by its path, and whether it can be used: shapes, numbers, labels, channels."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from cablesense_base import Array
from cablesense_gap.recordings.csv_file import (
    LOAD,
    LOAD_SEGMENT,
    TIME,
    command_columns,
    read_csv,
    tension_columns,
)
from cablesense_gap.recordings.mcap_file import is_bag, read_mcap
from cablesense_gap.recordings.recording import Recording, RecordingError, rows_named
from cablesense_msgs_py.messages import MAX_JOINT_ANGLE_RAD, MAX_LOAD_N
from cablesense_sim import kinematics
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import EquilibriumError, solve_equilibrium
from cablesense_sim.replay import reading_variance_n2

FEWEST_ROWS, FEWEST_TRIALS = 6, 2
"""Below these nothing can be held out."""
GOOD_ROWS, GOOD_TRIALS = 200, 8

_FASTEST_RAD_S = float(np.deg2rad(40.0))
"""Twice the speed at which arms approach a command; a faster command is a jump."""
_GAP_INTERVALS = 10.0
_MILLISECONDS = (700.0, 1400.0)
"""Steps of time over those of the sensors, where milliseconds are taken for seconds."""
_OTHER_RATE = 3.0
_MOVED_FLOORS = 50.0
"""A cable whose prediction varies by this many noise floors must show it."""
_STUCK_TRIALS = 3
_SATURATED_RUNS = 3
_LEAST_CORRELATION = 0.5
"""No effect turns the responses of half the cables further away from the prediction than this."""
_SCALES = (0.2, 5.0)
"""Nor does any scale them by more."""
_STIFFNESS_ROWS = 40
_SOFTER = (0.3, 0.1, 0.03, 0.01)
_STIFFER = (3.0, 10.0, 30.0, 100.0)
_WORTH_FLOORS = 2.0
_BETTER = 0.4
"""A channel belongs to another cable whose prediction leaves less than this of the residual."""


class Severity(StrEnum):
    """Whether a recording can still be used."""

    WARN = "warn"
    REFUSE = "refuse"


@dataclass(frozen=True)
class Finding:
    """One problem of a recording.

    Attributes:
        severity: whether it rules the recording out.
        kind: one word for programs, such as `time` or `swapped`.
        text: what, where (rows from 1, columns by name) and what would be right.
    """

    severity: Severity
    kind: str
    text: str


_refuse = partial(Finding, Severity.REFUSE)
_warn = partial(Finding, Severity.WARN)


def refuse_unusable(recording: Recording, findings: Sequence[Finding]) -> None:
    """Nothing, where no finding rules the recording out.

    Raises:
        RecordingError: the first reason that rules it out, and how many more there are.
    """
    refusals = [f.text for f in findings if f.severity is Severity.REFUSE]
    if refusals:
        more = f" (and {len(refusals) - 1} more)" if len(refusals) > 1 else ""
        raise RecordingError(f"{recording.name}: {refusals[0]}{more}")


def read_recording(path: str | Path, arm: Arm) -> Recording:
    """Read a recording: a `.csv` file, a `.mcap` file or a rosbag2 folder; check its form.

    Raises:
        RecordingError: no such file, another format, or what cannot be used.
    """
    path = Path(path)
    if path.suffix.lower() == ".csv":
        recording = read_csv(path, arm)
    elif is_bag(path):
        recording = read_mcap(path, arm)
    else:
        raise RecordingError(
            f"{path}: no recording; give a .csv file, a .mcap file or a rosbag2 folder"
        )
    refuse_unusable(recording, check_form(recording, arm))
    return recording


def check_form(recording: Recording, arm: Arm) -> list[Finding]:
    """Problems of a recording by itself, whatever it is for: shapes, numbers, time, labels.

    The worst come first; later checks wait for earlier ones.
    """
    found: list[Finding] = []
    for checks in ((_shapes,), (_numbers,), (_time, _labels, _angles)):
        found = found or [f for check in checks for f in check(recording, arm)]
    return sorted(found, key=_rank)


def check_recording(
    recording: Recording,
    arm: Arm,
    nominal_n: Array | None = None,
    rows: NDArray[np.int64] | None = None,
) -> list[Finding]:
    """Problems of a recording that is to be diagnosed, the worst first.

    `nominal_n` is what the nominal arm predicts for the `rows` (K,), all of them if None, as
    (K, M): exchanged channels and other arms can only be found with it.
    """
    found = check_form(recording, arm)
    if not any(finding.severity is Severity.REFUSE for finding in found):
        found += [*_amount(recording), *channel_findings(recording, arm, nominal_n, rows)]
    return sorted(found, key=_rank)


def _rank(finding: Finding) -> bool:
    return finding.severity is not Severity.REFUSE


def channel_findings(
    recording: Recording,
    arm: Arm,
    nominal_n: Array | None,
    rows: NDArray[np.int64] | None = None,
) -> list[Finding]:
    """Problems of the channels: saturated, stuck, of other cables or another arm.

    Without a nominal prediction for the `rows`, as in `check_recording`, only constant and
    saturated ones can be found.
    """
    read = recording.tensions_n
    findings = list(_at_range_ends(read, arm))
    if np.ptp(recording.command_rad, axis=0).any() or np.ptp(recording.load_n, axis=0).any():
        findings += [
            _warn(
                "stuck",
                f"tension_{cable + 1}_n is {read[0, cable]:g} N in every row, whatever loads and "
                "poses; see whether its sensor is connected",
            )
            for cable in np.flatnonzero(np.ptp(read, axis=0) == 0.0)
        ]
    if nominal_n is None:
        return findings
    moved_n = _MOVED_FLOORS * float(np.sqrt(reading_variance_n2(arm.sensors)))
    predicted = np.ptp(nominal_n, axis=0) > moved_n
    if predicted.sum() < 2:
        return findings
    numbers = np.arange(len(recording)) if rows is None else rows
    compared = recording if rows is None else recording.rows(rows)
    read = compared.tensions_n
    cables = np.flatnonzero(predicted & (np.ptp(read, axis=0) > 0.0))
    own, expected = (v[:, cables] - v[:, cables].mean(axis=0) for v in (read, nominal_n))
    if len(cables) >= 2:
        swapped = list(_swapped(own, expected, cables))
        if swapped:  # other findings would be of the wrong channels
            return [*findings, *swapped]
    findings += _stuck(compared, numbers, nominal_n, moved_n)
    return [*findings, *_foreign(own, expected, arm)] if len(cables) >= 2 else findings


def stiffness_findings(recording: Recording, arm: Arm, nominal_n: Array) -> list[Finding]:
    """Whether the readings are those of an arm many times as stiff, or as soft, as the nominal.

    `nominal_n` (R, M) is the nominal arm's prediction. Effects of the arm file are left out.
    """
    rows = np.unique(np.linspace(0, len(recording) - 1, _STIFFNESS_ROWS).astype(int))
    few, mechanism = recording.rows(rows), mechanism_of(arm)

    def left_n(predicted_n: Array) -> float:
        residual = few.tensions_n - predicted_n
        return float((residual - residual.mean(axis=0)).std())

    own_n = left_n(nominal_n[rows])
    if own_n < _WORTH_FLOORS * float(np.sqrt(reading_variance_n2(arm.sensors))):
        return []
    found: dict[float, float] = {}
    for way in (_SOFTER, _STIFFER):
        for factor in way:
            other = replace(
                mechanism,
                stiffness_n_m=factor * mechanism.stiffness_n_m,
                cable_stiffness_n_m=factor * mechanism.cable_stiffness_n_m,
            )
            try:
                rest = solve_equilibrium(other, few.command_rad, few.forces_n)
            except EquilibriumError:
                break  # nor does a softer one
            found[factor] = left_n(rest.tensions_n)
    best = min(found, key=found.__getitem__, default=1.0)
    if found.get(best, own_n) >= _BETTER * own_n:
        return []
    times = f"{best:g} times as stiff" if best > 1.0 else f"{1.0 / best:g} times as soft"
    return [
        _warn(
            "stiffness",
            f"the readings fit an arm whose cables are {times} as those of arm {arm.name} "
            f"({found[best]:.2g} N are left, not {own_n:.2g} N); see the cables' stiffness in the "
            "arm file",
        )
    ]


def _shapes(recording: Recording, arm: Arm) -> Iterator[Finding]:
    if len(recording) == 0:
        yield _refuse("rows", "has no rows; it must have one per sample")
    for kind, values, wanted, has, right in (
        ("cables", recording.tensions_n, arm.cable_count, "tensions", "cables"),
        ("joints", recording.command_rad, arm.joint_count, "commanded angles", "joint angles"),
    ):
        if values.shape[1:] != (wanted,):
            count = values.shape[-1]
            yield _refuse(kind, f"has {count} {has} a row; arm {arm.name} has {wanted} {right}")


def _numbers(recording: Recording, arm: Arm) -> Iterator[Finding]:
    joints, cables = command_columns(arm.joint_count), tension_columns(arm.cable_count)
    numbers = [recording.time_s, recording.command_rad, recording.load_n, recording.tensions_n]
    columns = np.column_stack(numbers).T
    for name, values in zip([TIME, *joints, *LOAD, *cables], columns, strict=True):
        if (wrong := ~np.isfinite(values)).any():
            yield _refuse(
                "numbers",
                f"{name} is empty or not finite in {rows_named(wrong)}; every cell must be a "
                "number: leave out rows that lack one",
            )


def _time(recording: Recording, arm: Arm) -> Iterator[Finding]:
    steps, same_trial = np.diff(recording.time_s), np.diff(recording.trial) == 0
    back = np.append(False, steps <= 0.0)
    if back.any():
        yield _refuse(
            "time",
            f"{TIME} does not go on in {rows_named(back)}; each row must be later than "
            "the one before: sort the rows, and leave out those that stand twice",
        )
        return
    within = steps[same_trial]
    if within.size:
        usual = float(np.median(within))
        slower = usual * arm.sensors.rate_hz
        if _MILLISECONDS[0] <= slower <= _MILLISECONDS[1]:
            yield _refuse(
                "milliseconds",
                f"{TIME} goes in steps of {usual:g}, where the sensors of arm {arm.name} read "
                f"every {1.0 / arm.sensors.rate_hz:g} s; times are in s, and these seem to be "
                "milliseconds",
            )
            return
        if not 1.0 / _OTHER_RATE <= slower <= _OTHER_RATE:
            yield _warn(
                "rate",
                f"rows come every {usual:.3g} s, where sensors.rate_hz = {arm.sensors.rate_hz:g} "
                f"of arm {arm.name} says every {1.0 / arm.sensors.rate_hz:g} s; see whether "
                "times are in s, and whether the arm file is that of this arm",
            )
        gap = np.append(False, (steps > _GAP_INTERVALS * usual) & same_trial)
        if gap.any():
            yield _warn(
                "gap",
                f"{TIME} leaps over {steps[gap[1:]].max():.3g} s within a trial before "
                f"{rows_named(gap)}, where {usual:.3g} s is usual; a break ends a trial",
            )
    starts = np.append(True, ~same_trial)
    numbers, counts = np.unique(recording.trial[starts], return_counts=True)
    if (counts > 1).any():
        yield _warn(
            "trial",
            f"trial {numbers[counts > 1][0]} comes back after another one; a trial is one block "
            "of rows with a number of its own",
        )


def _labels(recording: Recording, arm: Arm) -> Iterator[Finding]:
    segment = recording.load_segment
    loaded = (recording.load_n != 0.0).any(axis=1)
    outside = (segment < 0) | (segment > arm.segment_count)
    if outside.any():
        yield _refuse(
            "segment",
            f"{LOAD_SEGMENT} is {segment[outside][0]} in {rows_named(outside)}; it must "
            f"be from 1 to {arm.segment_count}, or 0 without a load",
        )
    unnamed = loaded & (segment == 0)
    if unnamed.any():
        yield _refuse(
            "label",
            f"a load stands in {rows_named(unnamed)} beside {LOAD_SEGMENT} 0; name the "
            "segment it acts on, or give 0 N",
        )
    bare = ~loaded & (segment > 0)
    if bare.any():
        yield _warn(
            "label",
            f"{LOAD_SEGMENT} names a segment beside a load of 0 N in {rows_named(bare)}; "
            "0 is right there, unless a load was forgotten",
        )
    huge = (recording.load_n**2).sum(axis=1) > MAX_LOAD_N**2
    if huge.any():
        yield _refuse(
            "load", f"the load is over {MAX_LOAD_N:g} N in {rows_named(huge)}; loads are in N"
        )


def _angles(recording: Recording, arm: Arm) -> Iterator[Finding]:
    command = recording.command_rad
    far = np.asarray((np.abs(command) > MAX_JOINT_ANGLE_RAD).any(axis=1))
    if far.any():
        yield _refuse(
            "degrees",
            f"a commanded angle is {np.abs(command).max():.4g} rad in {rows_named(far)}; angles "
            "are in rad, and these seem to be degrees",
        )
        return
    limit = mechanism_of(arm).bend_limit_rad
    bent = (kinematics.bend_rad(command) >= limit).any(axis=1)
    if bent.any():
        yield _refuse(
            "bend",
            f"the command bends a joint so far in {rows_named(bent)} that guide plates meet, at "
            f"{np.rad2deg(limit.min()):.1f} degrees; angles are in rad, of this arm's joints",
        )
    moved_rad = np.abs(np.diff(command, axis=0)).max(axis=1)
    fast = moved_rad > _FASTEST_RAD_S * np.diff(recording.time_s)
    # over a break between trials the arm had all the time it needed
    jump = np.append(False, fast & (np.diff(recording.trial) == 0))
    if jump.any():
        yield _warn(
            "jump",
            f"the command jumps in {rows_named(jump)}, and the arm follows later; send a move in "
            "small steps, or leave out the rows until the arm is there",
        )


def _amount(recording: Recording) -> Iterator[Finding]:
    rows, trials = len(recording), len(np.unique(recording.trial))
    if rows < FEWEST_ROWS or trials < FEWEST_TRIALS:
        yield _refuse(
            "amount",
            f"has {rows} rows in {trials} trials; a diagnosis needs at least {FEWEST_ROWS} "
            f"rows in {FEWEST_TRIALS} trials, since it judges on trials it has not seen",
        )
    elif rows < GOOD_ROWS or trials < GOOD_TRIALS:
        yield _warn(
            "amount",
            f"has only {rows} rows in {trials} trials; `cablesense gap protocol` lists what to "
            "record so that effects can be told apart",
        )


def _at_range_ends(read: Array, arm: Arm) -> Iterator[Finding]:
    if arm.sensors.range_n is None:
        return
    low, high = arm.sensors.range_n
    tolerance = 0.5 * arm.sensors.step_n
    for cable, values in enumerate(read.T, start=1):
        for end, limit in ((values <= low - tolerance, low), (values >= high - tolerance, high)):
            if end.any():
                yield _warn(
                    "saturated",
                    f"tension_{cable}_n is at the end of the sensors' range, {limit:g} N, in "
                    f"{rows_named(end)}; load less, or widen the range",
                )


def _stuck(
    recording: Recording, numbers: NDArray[np.int64], nominal_n: Array, moved_n: float
) -> Iterator[Finding]:
    """Channels that stop at one value while the prediction moves on; rows have `numbers` from 0.

    Friction and slack hold a tension as well, but not from one trial to the next, as a dead
    channel does, nor at the same maximum in one cycle of loads after another.
    """
    channels = zip(recording.tensions_n.T, nominal_n.T, strict=True)
    for cable, (values, predicted) in enumerate(channels, start=1):
        if np.ptp(values) == 0.0:  # found already
            continue
        edges = np.flatnonzero(np.concatenate([[True], np.diff(values) != 0.0, [True]]))
        runs = [slice(start, end) for start, end in pairwise(edges)]
        longest = max(runs, key=lambda run: run.stop - run.start)
        trials = len(np.unique(recording.trial[longest]))
        if trials >= _STUCK_TRIALS and np.ptp(predicted[longest]) > moved_n:
            yield _warn(
                "stuck",
                f"tension_{cable}_n stands still in rows {numbers[longest.start] + 1} to "
                f"{numbers[longest.stop - 1] + 1}, while loads or poses change; see whether its "
                "sensor is connected",
            )
            continue
        tops = [
            run for run in runs if values[run.start] == values.max() and run.stop - run.start >= 3
        ]
        at_top = np.concatenate([predicted[run] for run in tops]) if tops else np.zeros(1)
        if len(tops) >= _SATURATED_RUNS and np.ptp(at_top) > moved_n:
            highest = np.zeros(numbers[-1] + 1, dtype=bool)
            highest[numbers[values == values.max()]] = True
            yield _warn(
                "saturated",
                f"tension_{cable}_n does not exceed {values.max():g} N in "
                f"{rows_named(highest)}, while the load on it goes on; load less, "
                "or give the sensors' range_n in the arm file",
            )


def _swapped(own: Array, predicted: Array, cables: NDArray[np.int64]) -> Iterator[Finding]:
    """Channels that another cable's prediction explains better, if all fit an exchange.

    `own` and `predicted` (R, C) are of the C `cables`, less their means.
    """
    left_n = np.sqrt(((own[:, :, None] - predicted[:, None, :]) ** 2).mean(axis=0))
    channel, cable = linear_sum_assignment(left_n)
    moved = channel != cable
    better = left_n[channel, cable] < _BETTER * left_n[channel, channel]
    pairs = [
        f"tension_{cables[i] + 1}_n reads cable_{cables[j] + 1}"
        for i, j in zip(channel[moved & better], cable[moved & better], strict=True)
    ]
    if pairs and (better | ~moved).all():
        yield _warn(
            "swapped",
            f"{', '.join(pairs)}, by all that loads and poses do to it; see whether the plugs or "
            "the columns are exchanged",
        )


def _foreign(own: Array, predicted: Array, arm: Arm) -> Iterator[Finding]:
    """Tensions of another arm, or in another unit; as `_swapped`."""
    product, power = (own * predicted).sum(axis=0), (predicted**2).sum(axis=0)
    correlation = np.median(product / np.sqrt((own**2).sum(axis=0) * power))
    if correlation < _LEAST_CORRELATION:
        yield _refuse(
            "arm",
            f"the tensions do not follow loads and poses as arm {arm.name} does (correlation "
            f"{correlation:.2f}); give the arm file of this arm, and see that axes and signs of "
            "loads and joints are those of the base frame",
        )
        return
    scale = np.median(product / power)
    if not _SCALES[0] <= scale <= _SCALES[1]:
        yield _refuse(
            "unit",
            f"the tensions answer {scale:.3g} times as much as those of arm {arm.name}; they and "
            "the loads must be in N",
        )
