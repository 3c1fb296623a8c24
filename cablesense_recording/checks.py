"""Whether a recording can be used.

Its form first: shapes, numbers, time and labels. Then its channels: saturated, stuck or exchanged
ones, those of another arm.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from cablesense_base import Array
from cablesense_msgs_py.messages import MAX_LOAD_N
from cablesense_recording.channel_checks import (
    constant_channels,
    huge_values,
    silent_rows,
    time_findings,
)
from cablesense_recording.channels import LOAD, LOAD_AT, LOAD_SEGMENT, TIME, tension_columns
from cablesense_recording.layout import Described, Layout, layout_of
from cablesense_recording.recording import EXCHANGED, Finding, Recording, RowNames, refuse, warn
from cablesense_recording.units import time_unit_of
from cablesense_sim import kinematics
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.replay import reading_variance_n2

FEWEST_ROWS = 6
FEWEST_TRIALS = 2
"""Below these nothing can be held out."""
GOOD_ROWS = 200
GOOD_TRIALS = 8

_FASTEST_RAD_S = float(np.deg2rad(40.0))
"""Twice the speed at which arms approach a command; a faster command is a jump."""
_WARNED_INTERVALS = 10.0
"""A break that is left within a trial is warned of where rows are farther apart than this many
usual intervals."""
_OTHER_RATE = 3.0
_SAME_RATE = (0.7, 1.4)
"""Ratios of the rows' interval in some unit to the sensors' at which times are in that unit."""
_MOVED_FLOORS = 50.0
"""A cable whose prediction varies by this many noise floors must show it."""
_STUCK_TRIALS = 3
_SATURATED_RUNS = 3
_LEAST_CORRELATION = 0.5
"""No effect turns the responses of half the cables further away from the prediction than this."""
_SCALES = (0.2, 5.0)
"""No effect scales them by more."""
_BETTER = 0.4
"""A channel belongs to another cable whose prediction leaves less than this of the residual."""


def check_form(recording: Recording, machine: Described) -> list[Finding]:
    """Problems of a recording by itself, whatever it is for: shapes, numbers, time, labels.

    The worst come first; later checks wait for earlier ones.
    """
    layout = layout_of(machine)
    rate_hz = machine.sensors.rate_hz if isinstance(machine, Arm) else None
    findings = list(_shapes(recording, layout)) or list(_numbers(recording, layout))
    if not findings:
        findings += _time(recording, layout, rate_hz)
        findings += _labels(recording, layout)
        beyond = list(_commands(recording, layout))
        findings += beyond
        if isinstance(machine, Arm) and not beyond:
            findings += _angles(recording, machine)
    return sorted(findings, key=lambda each: not each.refuses)


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
    findings = check_form(recording, arm)
    if not any(finding.refuses for finding in findings):
        findings += [*_amount(recording), *_channels(recording, arm, nominal_n, rows)]
    return sorted(findings, key=lambda each: not each.refuses)


def _shapes(recording: Recording, layout: Layout) -> Iterator[Finding]:
    if len(recording) == 0:
        yield refuse("rows", "has no rows; it must have one per sample")
    channels = len(layout.channel_names)
    joints = len(layout.command_names)
    for kind, values, wanted, has, right in (
        ("cables", recording.tensions_n, channels, "tensions", "cables"),
        ("joints", recording.command_rad, joints, "commanded angles", "joint angles"),
    ):
        if values.shape[1:] != (wanted,):
            count = values.shape[-1]
            yield refuse(kind, f"has {count} {has} a row; {layout.name} has {wanted} {right}")


def _numbers(recording: Recording, layout: Layout) -> Iterator[Finding]:
    remedy = "leave out rows that lack one"
    if recording.row_names.of_bag:
        remedy = "see what their publisher sends, and record again"
    joints = layout.command_columns
    cables = layout.reading_columns
    numbers = [recording.time_s, recording.command_rad, recording.load_n, recording.tensions_n]
    columns = np.column_stack(numbers).T
    for name, values in zip([TIME, *joints, *LOAD, *cables], columns, strict=True):
        if (wrong := ~np.isfinite(values)).any():
            yield refuse(
                "numbers",
                f"{name} is empty or not finite in {recording.where(wrong)}; each must have a "
                f"number: {remedy}",
            )
        elif name != TIME:
            yield from huge_values(name, values, recording.row_names)


def _time(recording: Recording, layout: Layout, rate_hz: float | None) -> Iterator[Finding]:
    """Findings on the clock; `rate_hz` is that of the sensors, where it is known."""
    steps = np.diff(recording.time_s)
    same_trial = np.diff(recording.trial) == 0
    names = recording.row_names
    may_restart = np.zeros(len(recording), dtype=bool)
    wrong = list(time_findings(recording.time_s, may_restart, names, of_bag=names.of_bag))
    if wrong:
        yield from wrong
        return
    within = steps[same_trial]
    if within.size:
        usual = float(np.median(within))
        slower = 1.0 if rate_hz is None else usual * rate_hz
        read_s = usual / slower
        unit = time_unit_of(usual, (_SAME_RATE[0] * read_s, _SAME_RATE[1] * read_s))
        if unit:
            yield refuse(
                unit,
                f"rows come every {usual:g} s, and the sensors of {layout.name} read every "
                f"{read_s:g} s; {TIME} must be in s, not in {unit}",
            )
            return
        if not 1.0 / _OTHER_RATE <= slower <= _OTHER_RATE:
            yield warn(
                "rate",
                f"rows come every {usual:.3g} s, where sensors.rate_hz = {rate_hz:g} "
                f"of {layout.name} says every {read_s:g} s; see whether "
                "times are in s, and whether the arm file is that of this arm",
            )
        is_break = np.append(False, (steps > _WARNED_INTERVALS * usual) & same_trial)
        if is_break.any():
            yield warn(
                "break",
                f"{TIME} has a break of {steps[is_break[1:]].max():.3g} s within a trial before "
                f"{recording.where(is_break)}, where {usual:.3g} s is usual; begin a trial there",
            )
    starts = np.append(True, ~same_trial)
    numbers, counts = np.unique(recording.trial[starts], return_counts=True)
    if (counts > 1).any():
        yield warn(
            "trial",
            f"trial {numbers[counts > 1][0]} comes back after another one; a trial is one block "
            "of rows with one number",
        )


def _labels(recording: Recording, layout: Layout) -> Iterator[Finding]:
    count = len(layout.link_names)
    segment = recording.load_segment
    loaded = (recording.load_n != 0.0).any(axis=1)
    outside = (segment < 0) | (segment > count)
    if outside.any():
        yield refuse(
            "segment",
            f"{LOAD_SEGMENT} is {segment[outside][0]} in {recording.where(outside)}; it must "
            f"be from 1 to {count}, or 0 without a load",
        )
    unnamed = loaded & (segment == 0)
    if unnamed.any():
        yield refuse(
            "label",
            f"a load is given in {recording.where(unnamed)} with {LOAD_SEGMENT} 0; name the "
            "segment it acts on, or give 0 N",
        )
    if recording.load_at_m is not None:
        range_m = layout.loadable_m[np.clip(segment, 1, count) - 1]
        low_m = range_m[:, 0]
        high_m = range_m[:, 1]
        at_m = recording.load_at_m
        off = (segment > 0) & ((at_m < low_m) | (at_m > high_m))
        if off.any():
            first = int(np.argmax(off))
            link = layout.link_names[segment[first] - 1].replace("_", " ")
            yield refuse(
                "place",
                f"{LOAD_AT} is {at_m[first]:g} in {recording.where(off)}; on {link} it must be "
                f"from {low_m[first]:g} to {high_m[first]:g} m along its axis, or empty for "
                f"{layout.default_m}",
            )
    huge = (recording.load_n**2).sum(axis=1) > MAX_LOAD_N**2
    if huge.any():
        yield refuse(
            "load", f"the load is over {MAX_LOAD_N:g} N in {recording.where(huge)}; loads are in N"
        )


def _commands(recording: Recording, layout: Layout) -> Iterator[Finding]:
    command = recording.command_rad
    far = np.asarray((np.abs(command) > layout.largest_command).any(axis=1))
    if far.any():
        yield refuse(
            "degrees",
            f"a commanded angle is {np.abs(command).max():.4g} rad in {recording.where(far)}; "
            "angles are in rad, and these seem to be degrees",
        )


def _angles(recording: Recording, arm: Arm) -> Iterator[Finding]:
    command = recording.command_rad
    limit = mechanism_of(arm).bend_limit_rad
    bent = np.asarray((kinematics.bend_rad(command) >= limit).any(axis=1))
    if bent.any():
        yield refuse(
            "bend",
            f"the command bends a joint so far in {recording.where(bent)} that guide plates meet, "
            f"at {np.rad2deg(limit.min()):.1f} degrees; angles are in rad, of this arm's joints",
        )
    moved_rad = np.abs(np.diff(command, axis=0)).max(axis=1)
    fast = moved_rad > _FASTEST_RAD_S * np.diff(recording.time_s)
    # over a break between trials the arm had all the time it needed
    jump = np.append(False, fast & (np.diff(recording.trial) == 0))
    if jump.any():
        yield warn(
            "jump",
            f"the command jumps in {recording.where(jump)}, and the arm follows later; send a "
            "move in small steps, or leave out the rows until the arm is there",
        )


def _amount(recording: Recording) -> Iterator[Finding]:
    rows = len(recording)
    trials = len(np.unique(recording.trial))
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


def _channels(
    recording: Recording, arm: Arm, nominal_n: Array | None, rows: NDArray[np.int64] | None
) -> list[Finding]:
    """Problems of the channels: saturated, stuck, of other cables or another arm.

    Without a nominal prediction for the `rows`, as in `check_recording`, only constant and
    saturated ones can be found.
    """
    read = recording.tensions_n
    findings = list(_at_range_ends(recording, arm))
    if np.ptp(recording.command_rad, axis=0).any() or np.ptp(recording.load_n, axis=0).any():
        findings += [
            warn(
                "stuck",
                f"tension_{cable + 1}_n is {read[0, cable]:g} N in every row, whatever loads and "
                "poses; see whether its sensor is connected",
            )
            for cable in constant_channels(tension_columns(arm.cable_count), read)
        ]
    else:
        findings.append(
            warn(
                "stuck",
                "no command changes in any row, and no load; a diagnosis needs an arm that moves "
                "or is loaded: publish its commands while the recorder runs",
            )
        )
    silent = {cable: _silent_rows(recording, values, arm) for cable, values in enumerate(read.T)}
    findings += [
        warn(
            "stuck",
            f"tension_{cable + 1}_n stands still in {recording.row_names.span(run)}, and has "
            "noise elsewhere; see whether its sensor is connected",
        )
        for cable, run in silent.items()
        if run is not None
    ]
    if nominal_n is None:
        return findings
    moved_n = _MOVED_FLOORS * float(np.sqrt(reading_variance_n2(arm.sensors)))
    predicted = np.ptp(nominal_n, axis=0) > moved_n
    if predicted.sum() < 2:
        return findings
    rows = np.arange(len(recording)) if rows is None else rows
    compared = recording.rows(rows)
    read = compared.tensions_n
    cables = np.flatnonzero(predicted & (np.ptp(read, axis=0) > 0.0))
    centred_read, expected = (v[:, cables] - v[:, cables].mean(axis=0) for v in (read, nominal_n))
    known = {cable for cable, run in silent.items() if run is not None}
    stuck = list(_stuck(compared, recording.row_names.only(rows), nominal_n, moved_n, known))
    if len(cables) < 2:
        return [*findings, *stuck]
    exchanged = list(_exchanged(centred_read, expected, cables))
    if exchanged:  # other findings would be of the wrong channels
        return [*findings, *exchanged]
    _, pose = np.unique(compared.command_rad, axis=0, return_inverse=True)
    responses_n = [(centred_read, expected)]
    of_loads = _less_means(centred_read, pose), _less_means(expected, pose)
    if (np.ptp(of_loads[1], axis=0) > moved_n).all():
        responses_n.append(of_loads)
    return [*findings, *stuck, *_foreign(responses_n, arm)]


def _at_range_ends(recording: Recording, arm: Arm) -> Iterator[Finding]:
    """Saturated channels. A reading of 0 N is no finding: a slack cable has no tension."""
    if arm.sensors.range_n is None:
        return
    low, high = arm.sensors.range_n
    tolerance = 0.5 * arm.sensors.step_n
    for cable, values in enumerate(recording.tensions_n.T, start=1):
        for end, limit in ((values <= low - tolerance, low), (values >= high - tolerance, high)):
            if end.any() and limit != 0.0:
                yield warn(
                    "saturated",
                    f"tension_{cable}_n is at the end of the sensors' range, {limit:g} N, in "
                    f"{recording.where(end)}; load less, or widen the range",
                )


def _silent_rows(recording: Recording, values: Array, arm: Arm) -> slice | None:
    """The rows of several trials in which a channel (R,) stands still, without its noise.

    A slack cable may, and a sensor at the end of its range.
    """
    run = silent_rows(values)
    if run is None or len(np.unique(recording.trial[run])) < _STUCK_TRIALS:
        return None
    reading_n = float(values[run.start])
    ends = () if arm.sensors.range_n is None else arm.sensors.range_n
    at_an_end = any(abs(reading_n - end) <= arm.sensors.step_n for end in ends)
    of_range = at_an_end or reading_n in (0.0, values.min(), values.max())
    return None if of_range else run


def _stuck(
    recording: Recording, names: RowNames, nominal_n: Array, moved_n: float, known: set[int]
) -> Iterator[Finding]:
    """Channels that stay at one value while the prediction changes.

    Cables (from 0) that are `known` to are left out.

    Friction and slack hold a tension too. A dead channel holds it from one trial to the next, and
    a saturated one has the same maximum in several load cycles.
    """
    channels = zip(recording.tensions_n.T, nominal_n.T, strict=True)
    for cable, (values, predicted) in enumerate(channels, start=1):
        if np.ptp(values) == 0.0 or cable - 1 in known:
            continue
        edges = np.flatnonzero(np.concatenate([[True], np.diff(values) != 0.0, [True]]))
        runs = [slice(start, end) for start, end in pairwise(edges)]
        longest = max(runs, key=lambda run: run.stop - run.start)
        trials = len(np.unique(recording.trial[longest]))
        if trials >= _STUCK_TRIALS and np.ptp(predicted[longest]) > moved_n:
            yield warn(
                "stuck",
                f"tension_{cable}_n stands still in {names.span(longest)}, while loads or poses "
                "change; see whether its sensor is connected",
            )
            continue
        tops = [
            run for run in runs if values[run.start] == values.max() and run.stop - run.start >= 3
        ]
        at_top = np.concatenate([predicted[run] for run in tops]) if tops else np.zeros(1)
        if len(tops) >= _SATURATED_RUNS and np.ptp(at_top) > moved_n:
            highest = values == values.max()
            yield warn(
                "saturated",
                f"tension_{cable}_n does not exceed {values.max():g} N in "
                f"{names.of(highest)}, while the load on it increases; load less, "
                "or give the sensors' range_n in the arm file",
            )


def _exchanged(own: Array, predicted: Array, cables: NDArray[np.int64]) -> Iterator[Finding]:
    """Channels that another cable's prediction explains better, if all fit an exchange.

    `own` and `predicted` (R, C) are of the C `cables`, less their means.
    """
    left_n = np.sqrt(((own[:, :, None] - predicted[:, None, :]) ** 2).mean(axis=0))
    # cables that answer alike would be exchanged by chance
    costs = np.where(np.eye(len(cables), dtype=bool), left_n, left_n / _BETTER)
    channel, cable = linear_sum_assignment(costs)
    moved = channel != cable
    better = left_n[channel, cable] < _BETTER * left_n[channel, channel]
    pairs = [
        f"tension_{cables[i] + 1}_n reads cable_{cables[j] + 1}"
        for i, j in zip(channel[moved & better], cable[moved & better], strict=True)
    ]
    if pairs and (better | ~moved).all():
        yield refuse(
            EXCHANGED,
            f"{', '.join(pairs)}, by all that loads and poses do to it: plugs or columns look "
            "exchanged; correct the recording, or continue with --force",
        )


def _foreign(responses_n: list[tuple[Array, Array]], arm: Arm) -> list[Finding]:
    """Tensions of another arm, or in another unit, if no pair of `responses_n` is of this one.

    A pair is the readings and the predictions (R, C), both without their means. Springs in joints
    outweigh the rest of a recording over poses, and friction hides loads, but neither does both.
    """
    findings = []
    for read, predicted in responses_n:
        product = (read * predicted).sum(axis=0)
        power = (predicted**2).sum(axis=0)
        correlation = np.median(product / np.sqrt((read**2).sum(axis=0) * power))
        scale = np.median(product / power)
        if correlation < _LEAST_CORRELATION:
            findings.append(
                refuse(
                    "arm",
                    f"the tensions do not follow loads and poses as arm {arm.name} does "
                    f"(correlation {correlation:.2f}); give the arm file of this arm, and see "
                    "that axes and signs of loads and joints are those of the base frame",
                )
            )
        elif not _SCALES[0] <= scale <= _SCALES[1]:
            findings.append(
                refuse(
                    "unit",
                    f"the tensions answer {scale:.3g} times as much as those of arm {arm.name}; "
                    "they and the loads must be in N",
                )
            )
        else:
            return []
    return findings[:1]


def _less_means(values: Array, group: NDArray[np.int64]) -> Array:
    """`values` (R, C) minus the mean of their group (R,)."""
    sums = np.zeros((group.max() + 1, values.shape[1]))
    np.add.at(sums, group, values)
    return values - (sums / np.bincount(group)[:, None])[group]
