"""A recording read by its path, and checked in its form: shapes, numbers, time and labels."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_gap.recordings.channels import (
    EXCHANGED,
    Finding,
    Severity,
    channel_findings,
    refuse,
    warn,
)
from cablesense_gap.recordings.csv_file import (
    LOAD,
    LOAD_AT,
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

FEWEST_ROWS, FEWEST_TRIALS = 6, 2
"""Below these nothing can be held out."""
GOOD_ROWS, GOOD_TRIALS = 200, 8

_FASTEST_RAD_S = float(np.deg2rad(40.0))
"""Twice the speed at which arms approach a command; a faster command is a jump."""
_GAP_INTERVALS = 10.0
_OTHER_RATE = 3.0
_MILLISECONDS = (700.0, 1400.0)
"""Ratios of the rows' interval to the sensors', where milliseconds are taken for seconds."""


def _rank(finding: Finding) -> bool:
    return finding.severity is not Severity.REFUSE


def refuse_unusable(
    recording: Recording, findings: Sequence[Finding], *, force: bool = False
) -> None:
    """Nothing, where no finding rules the recording out; with `force`, exchanged channels do not.

    Raises:
        RecordingError: the first reason that rules it out, and how many more there are.
    """
    refusals = [
        f.text
        for f in findings
        if f.severity is Severity.REFUSE and not (force and f.kind == EXCHANGED)
    ]
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


def _shapes(recording: Recording, arm: Arm) -> Iterator[Finding]:
    if len(recording) == 0:
        yield refuse("rows", "has no rows; it must have one per sample")
    for kind, values, wanted, has, right in (
        ("cables", recording.tensions_n, arm.cable_count, "tensions", "cables"),
        ("joints", recording.command_rad, arm.joint_count, "commanded angles", "joint angles"),
    ):
        if values.shape[1:] != (wanted,):
            count = values.shape[-1]
            yield refuse(kind, f"has {count} {has} a row; arm {arm.name} has {wanted} {right}")


def _numbers(recording: Recording, arm: Arm) -> Iterator[Finding]:
    joints, cables = command_columns(arm.joint_count), tension_columns(arm.cable_count)
    numbers = [recording.time_s, recording.command_rad, recording.load_n, recording.tensions_n]
    columns = np.column_stack(numbers).T
    for name, values in zip([TIME, *joints, *LOAD, *cables], columns, strict=True):
        if (wrong := ~np.isfinite(values)).any():
            yield refuse(
                "numbers",
                f"{name} is empty or not finite in {rows_named(wrong)}; every cell must be a "
                "number: leave out rows that lack one",
            )


def _time(recording: Recording, arm: Arm) -> Iterator[Finding]:
    steps, same_trial = np.diff(recording.time_s), np.diff(recording.trial) == 0
    back = np.append(False, steps <= 0.0)
    if back.any():
        yield refuse(
            "time",
            f"{TIME} does not increase in {rows_named(back)}; each row must be later than "
            "the one before: sort the rows, and leave out those that stand twice",
        )
        return
    within = steps[same_trial]
    if within.size:
        usual = float(np.median(within))
        slower = usual * arm.sensors.rate_hz
        if _MILLISECONDS[0] <= slower <= _MILLISECONDS[1]:
            yield refuse(
                "milliseconds",
                f"rows come every {usual:g} s, and the sensors of arm {arm.name} read every "
                f"{1.0 / arm.sensors.rate_hz:g} s; {TIME} must be in s, not in milliseconds",
            )
            return
        if not 1.0 / _OTHER_RATE <= slower <= _OTHER_RATE:
            yield warn(
                "rate",
                f"rows come every {usual:.3g} s, where sensors.rate_hz = {arm.sensors.rate_hz:g} "
                f"of arm {arm.name} says every {1.0 / arm.sensors.rate_hz:g} s; see whether "
                "times are in s, and whether the arm file is that of this arm",
            )
        gap = np.append(False, (steps > _GAP_INTERVALS * usual) & same_trial)
        if gap.any():
            yield warn(
                "gap",
                f"{TIME} leaps over {steps[gap[1:]].max():.3g} s within a trial before "
                f"{rows_named(gap)}, where {usual:.3g} s is usual; a break ends a trial",
            )
    starts = np.append(True, ~same_trial)
    numbers, counts = np.unique(recording.trial[starts], return_counts=True)
    if (counts > 1).any():
        yield warn(
            "trial",
            f"trial {numbers[counts > 1][0]} comes back after another one; a trial is one block "
            "of rows with one number",
        )


def _labels(recording: Recording, arm: Arm) -> Iterator[Finding]:
    segment = recording.load_segment
    loaded = (recording.load_n != 0.0).any(axis=1)
    outside = (segment < 0) | (segment > arm.segment_count)
    if outside.any():
        yield refuse(
            "segment",
            f"{LOAD_SEGMENT} is {segment[outside][0]} in {rows_named(outside)}; it must "
            f"be from 1 to {arm.segment_count}, or 0 without a load",
        )
    unnamed = loaded & (segment == 0)
    if unnamed.any():
        yield refuse(
            "label",
            f"a load is given in {rows_named(unnamed)} with {LOAD_SEGMENT} 0; name the "
            "segment it acts on, or give 0 N",
        )
    if recording.load_at_m is not None:
        length_m = mechanism_of(arm).segment_length_m
        own_m = length_m[np.clip(segment, 1, arm.segment_count) - 1]
        at_m = recording.load_at_m
        off = (segment > 0) & ((at_m < 0.0) | (at_m > own_m))
        if off.any():
            first = int(np.argmax(off))
            yield refuse(
                "place",
                f"{LOAD_AT} is {at_m[first]:g} in {rows_named(off)}; on segment {segment[first]} "
                f"it must be from 0 to {own_m[first]:g} m from the joint centre, or empty for "
                "contact_m of the arm file",
            )
    huge = (recording.load_n**2).sum(axis=1) > MAX_LOAD_N**2
    if huge.any():
        yield refuse(
            "load", f"the load is over {MAX_LOAD_N:g} N in {rows_named(huge)}; loads are in N"
        )


def _angles(recording: Recording, arm: Arm) -> Iterator[Finding]:
    command = recording.command_rad
    far = np.asarray((np.abs(command) > MAX_JOINT_ANGLE_RAD).any(axis=1))
    if far.any():
        yield refuse(
            "degrees",
            f"a commanded angle is {np.abs(command).max():.4g} rad in {rows_named(far)}; angles "
            "are in rad, and these seem to be degrees",
        )
        return
    limit = mechanism_of(arm).bend_limit_rad
    bent = np.asarray((kinematics.bend_rad(command) >= limit).any(axis=1))
    if bent.any():
        yield refuse(
            "bend",
            f"the command bends a joint so far in {rows_named(bent)} that guide plates meet, at "
            f"{np.rad2deg(limit.min()):.1f} degrees; angles are in rad, of this arm's joints",
        )
    moved_rad = np.abs(np.diff(command, axis=0)).max(axis=1)
    fast = moved_rad > _FASTEST_RAD_S * np.diff(recording.time_s)
    # over a break between trials the arm had all the time it needed
    jump = np.append(False, fast & (np.diff(recording.trial) == 0))
    if jump.any():
        yield warn(
            "jump",
            f"the command jumps in {rows_named(jump)}, and the arm follows later; send a move in "
            "small steps, or leave out the rows until the arm is there",
        )


def _amount(recording: Recording) -> Iterator[Finding]:
    rows, trials = len(recording), len(np.unique(recording.trial))
    if rows < FEWEST_ROWS or trials < FEWEST_TRIALS:
        yield refuse(
            "amount",
            f"has {rows} rows in {trials} trials; a diagnosis needs at least {FEWEST_ROWS} "
            f"rows in {FEWEST_TRIALS} trials, since it judges on trials it has not seen",
        )
    elif rows < GOOD_ROWS or trials < GOOD_TRIALS:
        yield warn(
            "amount",
            f"has only {rows} rows in {trials} trials; `cablesense gap protocol` lists what to "
            "record so that effects can be distinguished",
        )
