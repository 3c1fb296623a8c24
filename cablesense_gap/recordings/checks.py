"""All checks of a recording, as one report.

Whether a recording can be one of its arm at all: shapes, numbers, time, trials and labels.

A recording by its path, whatever its format.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from cablesense_base.arrays import Array
from cablesense_gap.recordings import csv_file
from cablesense_gap.recordings.channel_checks import (
    Finding,
    RecordingReport,
    Severity,
    channel_findings,
    refuse,
    warn,
)
from cablesense_gap.recordings.csv_file import read_csv
from cablesense_gap.recordings.mcap_file import is_bag, read_mcap
from cablesense_gap.recordings.recording import Recording, RecordingError, rows_named
from cablesense_msgs_py.joint_states import MAX_JOINT_ANGLE_RAD
from cablesense_msgs_py.wrenches import MAX_LOAD_N
from cablesense_sim import kinematics
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of

FASTEST_RAD_S = float(np.deg2rad(40.0))
"""Twice the speed at which arms approach a command; a faster command is a jump."""
GAP_INTERVALS = 10.0


def form_findings(recording: Recording, arm: Arm) -> list[Finding]:
    """What is wrong with shapes, numbers, time and labels; later checks wait for earlier ones."""
    for check in (_shapes, _numbers, _content):
        findings = list(check(recording, arm))
        if findings:
            return findings
    return []


def _shapes(recording: Recording, arm: Arm) -> Iterator[Finding]:
    rows, cables, joints = len(recording), arm.cable_count, arm.joint_count
    if rows == 0:
        yield refuse("rows", "has no rows; it must have one per sample")
    if recording.tensions_n.shape[1:] != (cables,):
        yield refuse(
            "cables",
            f"has {recording.tensions_n.shape[-1]} tensions a row; arm {arm.name} has {cables} "
            "cables",
        )
    if recording.command_rad.shape[1:] != (joints,):
        yield refuse(
            "joints",
            f"has {recording.command_rad.shape[-1]} commanded angles a row; arm {arm.name} has "
            f"{joints}, pitch and yaw of each joint",
        )


def _numbers(recording: Recording, arm: Arm) -> Iterator[Finding]:
    named = {
        csv_file.TIME: recording.time_s,
        **dict(
            zip(csv_file.command_columns(arm.joint_count), recording.command_rad.T, strict=True)
        ),
        **dict(zip(csv_file.LOAD, recording.load_n.T, strict=True)),
        **dict(
            zip(csv_file.tension_columns(arm.cable_count), recording.tensions_n.T, strict=True)
        ),
    }
    for name, values in named.items():
        wrong = ~np.isfinite(values)
        if wrong.any():
            yield refuse(
                "numbers",
                f"{name} is empty or not finite in {rows_named(wrong)}; every cell must be a "
                "number: leave out rows that lack one",
            )


def _content(recording: Recording, arm: Arm) -> Iterator[Finding]:
    yield from _time(recording)
    yield from _labels(recording, arm)
    yield from _angles(recording, arm)


def _time(recording: Recording) -> Iterator[Finding]:
    steps = np.diff(recording.time_s)
    back = np.concatenate([[False], steps <= 0.0])
    if back.any():
        yield refuse(
            "time",
            f"{csv_file.TIME} does not go on in {rows_named(back)}; each row must be later than "
            "the one before: sort the rows, and leave out those that stand twice",
        )
        return
    within = steps[np.diff(recording.trial) == 0]
    if within.size:
        usual = float(np.median(within))
        gap = np.concatenate([[False], (steps > GAP_INTERVALS * usual)])
        gap[1:] &= np.diff(recording.trial) == 0
        if gap.any():
            yield warn(
                "gap",
                f"{csv_file.TIME} leaps over {steps[gap[1:]].max():.3g} s within a trial before "
                f"{rows_named(gap)}, where {usual:.3g} s is usual; a break ends a trial",
            )
    starts = np.concatenate([[True], np.diff(recording.trial) != 0])
    numbers, counts = np.unique(recording.trial[starts], return_counts=True)
    if (counts > 1).any():
        yield warn(
            "trial",
            f"trial {numbers[counts > 1][0]} comes back after another one; a trial is one block "
            "of rows with a number of its own",
        )


def _labels(recording: Recording, arm: Arm) -> Iterator[Finding]:
    segment = recording.load_segment
    loaded = (recording.load_n != 0.0).any(axis=1)
    outside = (segment < 0) | (segment > arm.segment_count)
    if outside.any():
        yield refuse(
            "segment",
            f"{csv_file.LOAD_SEGMENT} is {segment[outside][0]} in {rows_named(outside)}; it must "
            f"be from 1 to {arm.segment_count}, or 0 without a load",
        )
    unnamed = loaded & (segment == 0)
    if unnamed.any():
        yield refuse(
            "label",
            f"a load stands in {rows_named(unnamed)} beside {csv_file.LOAD_SEGMENT} 0; name the "
            "segment it acts on, or give 0 N",
        )
    bare = ~loaded & (segment > 0)
    if bare.any():
        yield warn(
            "label",
            f"{csv_file.LOAD_SEGMENT} names a segment beside a load of 0 N in {rows_named(bare)}; "
            "0 is right there, unless a load was forgotten",
        )
    huge = (recording.load_n**2).sum(axis=1) > MAX_LOAD_N**2
    if huge.any():
        yield refuse(
            "load",
            f"the load is over {MAX_LOAD_N:g} N in {rows_named(huge)}; loads are in N",
        )


def _angles(recording: Recording, arm: Arm) -> Iterator[Finding]:
    command = recording.command_rad
    far = np.asarray((np.abs(command) > MAX_JOINT_ANGLE_RAD).any(axis=1))
    if far.any():
        yield refuse(
            "degrees",
            f"a commanded angle is {np.abs(command).max():.4g} rad in {rows_named(far)}; angles "
            "are in rad, and these look like degrees",
        )
        return
    limit = mechanism_of(arm).bend_limit_rad
    bent = (kinematics.bend_rad(command) >= limit).any(axis=1)
    if bent.any():
        yield refuse(
            "bend",
            f"the command bends a joint so far in {rows_named(bent)} that guide plates meet, at "
            f"{np.rad2deg(limit.min()):.1f} degrees; angles are in rad, of this arm's joints",
        )
    moved_rad = np.abs(np.diff(command, axis=0)).max(axis=1)
    fast = moved_rad > FASTEST_RAD_S * np.diff(recording.time_s)
    # over a break between trials the arm had all the time it needed
    jump = np.concatenate([[False], fast & (np.diff(recording.trial) == 0)])
    if jump.any():
        yield warn(
            "jump",
            f"the command jumps in {rows_named(jump)}, and the arm follows later; send a move in "
            "small steps, or leave out the rows until the arm is there",
        )


FEWEST_ROWS, FEWEST_TRIALS = 6, 2
"""Below these nothing can be held out."""
GOOD_ROWS, GOOD_TRIALS = 200, 8


def check_recording(
    recording: Recording, arm: Arm, nominal_n: Array | None = None
) -> RecordingReport:
    """What is wrong with a recording that is to be diagnosed, the worst first.

    Args:
        recording: as read, or made.
        arm: the nominal arm.
        nominal_n: (R, M) tensions that the nominal arm predicts for the rows. Without them nothing
            is said of exchanged channels and other arms.
    """
    findings = form_findings(recording, arm)
    if all(finding.severity is not Severity.REFUSE for finding in findings):
        findings += _amount(recording)
        findings += channel_findings(recording, arm, nominal_n)
    ordered = sorted(findings, key=lambda finding: finding.severity is not Severity.REFUSE)
    return RecordingReport(recording.name, tuple(ordered))


def check_form(recording: Recording, arm: Arm) -> RecordingReport:
    """What is wrong with a recording by itself, whatever it is for: shapes, numbers, labels."""
    return RecordingReport(recording.name, tuple(form_findings(recording, arm)))


def _amount(recording: Recording) -> list[Finding]:
    rows, trials = len(recording), len(np.unique(recording.trial))
    if rows < FEWEST_ROWS or trials < FEWEST_TRIALS:
        return [
            refuse(
                "amount",
                f"has {rows} rows in {trials} trials; a diagnosis needs at least {FEWEST_ROWS} "
                f"rows in {FEWEST_TRIALS} trials, since it judges on trials it has not seen",
            )
        ]
    if rows < GOOD_ROWS or trials < GOOD_TRIALS:
        return [
            warn(
                "amount",
                f"has only {rows} rows in {trials} trials; `cablesense gap protocol` says what to "
                "record so that effects can be told apart",
            )
        ]
    return []


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
    check_form(recording, arm).raise_if_unusable()
    return recording
