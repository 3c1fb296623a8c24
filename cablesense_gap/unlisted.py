"""A gap that no listed effect explains: its pattern, and what to record to narrow it down.

A flexible model without physics (`diagnosis.discrepancy`) is fitted to the residual after
tolerances, on features of commands, loads and time. The pattern is a list of sentences for a
person who looks for the cause at the arm: the cables, what the residual depends on, its period,
its steps and jumps.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations_with_replacement

import numpy as np

from cablesense_base import Array
from cablesense_gap.diagnosis.discrepancy import (
    Conditions,
    Features,
    FlexibleModel,
    flexible_model,
)
from cablesense_gap.diagnosis.problem import Problem
from cablesense_gap.protocol import DIRECTIONS
from cablesense_gap.residuals import (
    BENT_RAD,
    CABLE,
    LEVEL,
    LOOP,
    Decomposition,
    decompose,
    segment_modes_n,
)
from cablesense_gap.system import Unlisted
from cablesense_gap.verdict import listed, short
from cablesense_recording.recording import Recording
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import held_lengths_m

_WITHIN_FLOORS = 1.2
"""Below this many floors there is no pattern to describe."""
_WAVES = np.arange(2.5, 20.0, 0.2)
"""Periods that a range of motion may hold; slower waves count as smooth."""
_NARROW_PLAY = 0.05
"""Half width of a play, as a share of a signal's range, that shows its last reversals."""
_WIDE_PLAY = 0.3
"""The same, for the last large reversals alone."""
_RECENT_S = 10.0
"""Time constant of what fades after a change of command or load."""
_STILL_M = 1e-9
"""Length of cable that counts as none from one row to the next."""
_LEAST_SQUARE_N2 = 1e-12
"""Mean square that counts as zero, N²."""
_MOST_OF_SQUARE = 0.8
"""Share of the mean square that the cables hold which are named."""
_ALIKE_TIMES_CHANCE = 1.8
"""Share of the mean mode, by that of chance, from which on a segment's cables change alike."""
_AGAINST_TIMES_CHANCE = 0.3
"""The same, up to which they change against each other."""
_WITHOUT_TORQUE = 0.6
"""Share of the modes without a torque from which on single cables are the cause."""
_DEPENDING_SHARE = 0.3
"""Share of a residual that one group of features must explain to be named."""
_REPRODUCIBLE_SHARE = 0.2
"""Share of a residual that a flexible model must explain for it to be reproducible."""
_GROWTH_TIMES = 2.0
"""Times the residual at the smallest loads, from which on it grows with the load."""
_LOOP_SHARE = 0.4
"""Share of the residual that the difference of loading and unloading must have."""
_WAVE_ROWS = 100
"""Unloaded rows from which a wave can be told."""
_WAVE_FLOORS = 1.5
"""Noise floors (RMS) of a residual, without what is smooth, from which it can hold a wave."""
_WAVE_SHARE = 0.25
"""Share of this residual that a wave must explain."""
_JOINT_FOR_CABLES = 0.7
"""Share of what waves of all cables explain from which on a joint's wave, which is simpler, is
named."""
_RANK_RATIO = 1e-9
"""Relative singular value that counts as zero."""
_STEP_ENDS = 0.05
"""Share of the rows at either end where a step cannot be told from a few unusual rows."""
_STEP_SHARE = 0.6
"""Share of a cable's mean square that a lasting step must explain."""
_STEP_FLOORS = 4.0
"""Noise floors of such a step."""
_JUMP_FLOORS = 8.0
"""Noise floors of a jump from one row to the next."""
_LATE_SHARE = 0.25
"""Share of a change by which it goes on where it is no jump, but the channel is late."""
_NAMED_CABLES = 3
"""Cables that a sentence names at most."""
_TRIAL_ROWS = 10
"""Rows of a trial that is worth repeating."""
_SAME_SIDE_COSINE = 0.9
"""Cosine of the angle between a load and a named side from which on the load is from there."""
ONE_AT_A_TIME = (
    "Record again under the conditions that are named above, and change one thing at a time: "
    "`cablesense gap protocol` lists loads, poses and holds that distinguish most effects."
)
_GROUPS = {
    "pose": "the commanded pose",
    "load": "the applied load",
    "tension": "the cables' tensions",
    "motion": "the direction in which cables move",
    "history": "the last reversals of the tensions",
    "time": "time",
}


def describe_unlisted(
    problem: Problem, residual: Array, recording: Recording, arm: Arm, conditions: Conditions
) -> Unlisted:
    """The pattern of a held-out residual (R, M), and the experiment to repeat."""
    used = problem.used
    floor_n = problem.floor
    features = residual_features(recording, problem.nominal, arm)
    rows = recording.rows(used)
    residual_used = residual[used]
    flexible = flexible_model(
        {
            group: {name: column[used] for name, column in group_features.items()}
            for group, group_features in features.items()
        },
        Conditions(*(column[used] for column in conditions)),
        residual_used,
        problem.fold[problem.trial[used]],
        floor_n,
    )
    reasons = (
        "A flexible model of commands, loads, directions and time, without physics, explains "
        f"{max(flexible.explained_share, 0.0):.0%} of the residual on held-out trials.",
        *residual_patterns(rows, residual_used, flexible, arm, floor_n),
    )
    correction = np.zeros_like(residual)
    correction[used] = flexible.held_out
    return Unlisted(reasons, repeat_largest_trial(rows, residual_used, floor_n), correction)


def residual_features(recording: Recording, nominal_n: Array, arm: Arm) -> Features:
    """Features of the rows, with the nominal prediction (R, M).

    pose: commanded angles. load: by segment and axis, and its magnitude; where places are stated,
    also times its distance from the nominal contact point. tension: of each cable in the nominal
    arm. motion: the sign of each cable's speed. history: how far each cable's tension is from the
    middle of a play that follows it, for a narrow and a wide play. time: since the recording
    began, and since the arm or its load last changed.
    """
    held_m = held_lengths_m(mechanism_of(arm), recording.command_rad)
    trial = recording.trial
    step_m = np.diff(held_m, axis=0, prepend=held_m[:1])
    step_m[np.diff(trial, prepend=trial[0]) != 0] = 0.0
    forces_n = recording.forces_n
    segments = range(1, arm.segment_count + 1)
    loads_n = forces_n.reshape(len(recording), -1)
    load_names = [f"load on segment_{n} along {axis}" for n in segments for axis in "xyz"]
    load = dict(zip(load_names, loads_n.T, strict=True))
    load["size of the load"] = np.linalg.norm(forces_n, axis=-1).sum(-1)
    places_m = recording.course.places_m
    if places_m is not None:
        beyond_m = np.nan_to_num(places_m - mechanism_of(arm).contact_m, nan=0.0)
        moments = (beyond_m[..., None] * forces_n).reshape(len(recording), -1)
        load |= {
            f"place of the {name}": moment
            for name, moment in zip(load_names, moments.T, strict=True)
        }
    state = np.column_stack([recording.command_rad, *load.values()])
    changed = (np.diff(state, axis=0, prepend=state[:1]) != 0.0).any(axis=1)
    last = np.maximum.accumulate(np.where(changed, np.arange(len(state)), 0))
    recent = np.exp(-(recording.time_s - recording.time_s[last]) / _RECENT_S)

    def of_cables(text: str, columns: Array) -> dict[str, Array]:
        return {
            text.format(c): moment for c, moment in zip(arm.cable_names, columns.T, strict=True)
        }

    narrow, wide = (in_play(nominal_n, share) for share in (_NARROW_PLAY, _WIDE_PLAY))
    commands = zip(arm.joint_names, recording.command_rad.T, strict=True)
    return {
        "pose": {f"{name} commanded": moment for name, moment in commands},
        "load": load,
        "tension": of_cables("tension of {}", nominal_n),
        "motion": of_cables(
            "motion of {}", np.sign(np.where(np.abs(step_m) > _STILL_M, step_m, 0.0))
        ),
        "history": of_cables("reversals of {}", narrow) | of_cables("large reversals of {}", wide),
        "time": {"time": recording.time_s, "time since the last change": recent},
    }


def in_play(signal: Array, share: float) -> Array:
    """The signal minus the middle of a play that follows it, in half widths, from -1 to 1.

    `share` is the half width of the play as a share of the signal's range.
    """
    half = np.maximum(share * np.ptp(signal, axis=0), 1e-9)
    middle = signal[0].copy()
    in_widths = np.empty_like(signal)
    for row, value in enumerate(signal):
        middle = np.clip(middle, value - half, value + half)
        in_widths[row] = (value - middle) / half
    return in_widths


def residual_patterns(
    recording: Recording, residual_n: Array, found: FlexibleModel, arm: Arm, floor_n: float
) -> tuple[str, ...]:
    """The pattern of a residual (R, M) in sentences; none if the residual is near the floor.

    `recording` and the residual hold the rows that count; `found` is the flexible model of it.

    Raises:
        ValueError: the residual has another shape than the readings.
    """
    parts = decompose(recording, residual_n, floor_n, arm)
    if parts.rms_n < _WITHIN_FLOORS * floor_n:
        return ()
    return (
        _cables(parts),
        *_modes(residual_n, arm),
        *_dependence(found),
        *_load(parts),
        *_wave(recording, residual_n, floor_n, arm),
        *_steps(recording, residual_n, floor_n, arm),
        *_jumps(recording, residual_n, floor_n, arm),
    )


def _cables(parts: Decomposition) -> str:
    """The fewest cables that hold four fifths of the mean square, if these are few."""
    ranked = sorted(parts.of_group(CABLE), key=lambda part: -part.rms_n)
    square = np.array([part.rms_n for part in ranked]) ** 2
    few = int(np.searchsorted(np.cumsum(square), _MOST_OF_SQUARE * square.sum())) + 1
    if few > len(ranked) // 3:
        return (
            f"It is in all cables: {ranked[-1].rms_n:.2g} to {ranked[0].rms_n:.2g} N RMS, with a "
            f"noise floor of {parts.floor_n:.2g} N."
        )
    numbers = [f"{_plain(p.member)} ({p.rms_n:.2g} N RMS)" for p in ranked[:few]]
    share = square[:few].sum() / square.sum()
    return f"{share:.0%} of its mean square is in {listed(numbers)}."


def _modes(residual_n: Array, arm: Arm) -> Iterator[str]:
    """How the cables of one segment change together, if chance hardly makes it so."""
    square = (segment_modes_n(residual_n, arm) ** 2).sum(axis=(0, 1))
    share = square / max(square.sum(), _LEAST_SQUARE_N2)
    chance = 1.0 / arm.cables.per_segment
    if share[0] >= _ALIKE_TIMES_CHANCE * chance:
        yield (
            "The cables that end on one segment change alike, as a wrong pretension or length "
            "would make them."
        )
    elif share[3:].sum() >= _WITHOUT_TORQUE:
        yield (
            "The cables that end on one segment change against each other without a torque on "
            "the segment, as wrong tensions or sensors of single cables would make them."
        )
    elif share[0] <= _AGAINST_TIMES_CHANCE * chance:
        yield (
            "The cables that end on one segment change against each other, as a torque on the "
            "segment would make them."
        )


def _dependence(found: FlexibleModel) -> Iterator[str]:
    group, share = max(found.alone.items(), key=lambda item: item[1], default=("", 0.0))
    if share >= _DEPENDING_SHARE:
        yield (
            f"It depends on {_GROUPS.get(group, group)}, most clearly on "
            f"{_plain(found.foremost)}: a flexible model of that alone predicts {share:.0%} of it "
            "on held-out trials."
        )
    elif found.explained_share < _REPRODUCIBLE_SHARE:
        yield (
            f"It is not reproducible: a flexible model predicts "
            f"{max(found.explained_share, 0.0):.0%} of it on held-out trials. Random events have "
            "this pattern, and poses or loads that occur only once."
        )


def _load(parts: Decomposition) -> Iterator[str]:
    levels = parts.of_group(LEVEL)
    if len(levels) > 1 and levels[-1].rms_n >= _GROWTH_TIMES * levels[0].rms_n:
        items = [f"{p.rms_n:.2g} N RMS for loads {p.member}" for p in levels]
        yield f"It grows with the load: {listed(items)}."
    for loop in parts.of_group(LOOP):
        if loop.rms_n >= max(_LOOP_SHARE * parts.rms_n, _WITHIN_FLOORS * parts.floor_n):
            yield (
                f"Loading and unloading differ by {2.0 * loop.rms_n:.2g} N RMS at one load: the "
                "cause depends on history, as friction, backlash and creep do."
            )


def _wave(recording: Recording, residual_n: Array, floor_n: float, arm: Arm) -> Iterator[str]:
    """The period along a joint's angle or the cables' lengths that explains most, if much.

    Screws, gears and detents have periods; effects that are smooth in the pose have none. A
    quadratic polynomial of all commands is therefore removed first. A wave is fitted to the
    readings of all cables, because the arm passes on the change of one. All cables share a period.
    """
    free = recording.load_segment == 0
    command = recording.command_rad[free]
    residual = residual_n[free]
    moving = np.ptp(command, axis=0) > 0.0 if len(command) else np.zeros(0, dtype=bool)
    if len(command) < _WAVE_ROWS or not moving.any():
        return
    moved = command[:, moving]
    products = [one * other for one, other in combinations_with_replacement(moved.T, 2)]
    columns = np.column_stack([np.ones(len(moved)), moved, *products])
    directions, size, _ = np.linalg.svd(columns, full_matrices=False)
    smooth = directions[:, size > _RANK_RATIO * size[0]]
    rest = residual - smooth @ (smooth.T @ residual)
    if np.sqrt((rest**2).mean()) < _WAVE_FLOORS * floor_n:
        return

    def best(along: Array) -> tuple[float, float]:
        """The share that one period of all coordinates (R, K) explains, and that period."""
        periods = float(np.ptp(along, axis=0).max()) / _WAVES
        shares = [_explained(along / each, rest, smooth) for each in periods]
        return float(max(shares) - np.median(shares)), float(periods[int(np.argmax(shares))])

    held_m = held_lengths_m(mechanism_of(arm), command)
    joints = [(*best(command[:, k : k + 1]), arm.joint_names[k]) for k in np.flatnonzero(moving)]
    (joint_share, period_rad, joint) = max(joints)
    (share, period_m) = best(held_m)
    if joint_share >= _JOINT_FOR_CABLES * share:
        if joint_share >= _WAVE_SHARE:
            yield (
                f"It repeats every {np.rad2deg(period_rad):.2g} degrees of {_plain(joint)}, as "
                "gear teeth or detents would make it."
            )
    elif share >= _WAVE_SHARE:
        alone = [_explained(column[:, None] / period_m, rest, smooth) for column in held_m.T]
        yield (
            f"It repeats every {1e3 * period_m:.2g} mm of cable, most in "
            f"{_plain(arm.cable_names[int(np.argmax(alone))])}, as a screw, a gear or a drum "
            "would make it."
        )


def _explained(turns: Array, rest: Array, smooth: Array) -> float:
    """Share of the square of `rest` that waves of these turns (R, K) explain beyond `smooth`."""
    wave = np.concatenate([np.sin(2.0 * np.pi * turns), np.cos(2.0 * np.pi * turns)], axis=1)
    wave -= smooth @ (smooth.T @ wave)
    square, along = np.linalg.eigh(wave.T @ wave)
    seen = square > 1e-12 * len(wave)  # the others are rounding errors of what is smooth
    moment = along[:, seen].T @ (wave.T @ rest)
    return float((moment**2 / square[seen, None]).sum() / (rest**2).sum())


def _steps(recording: Recording, residual_n: Array, floor_n: float, arm: Arm) -> Iterator[str]:
    """Cables in which one lasting step explains most of the scatter, the largest first."""
    count = len(residual_n)
    rows = np.arange(1, len(residual_n))
    centred = residual_n - residual_n.mean(0)
    weight = (rows * (count - rows) / count)[:, None]
    apart_n = -np.cumsum(centred, axis=0)[:-1] / weight
    explained = weight * apart_n**2 / np.maximum((centred**2).sum(0), _LEAST_SQUARE_N2)
    ends = (rows <= _STEP_ENDS * count) | (rows >= (1.0 - _STEP_ENDS) * count)
    explained[ends] = 0.0
    step_rows = explained.argmax(0)
    size_n = apart_n[step_rows, np.arange(len(step_rows))]
    clear = (explained.max(0) >= _STEP_SHARE) & (np.abs(size_n) >= _STEP_FLOORS * floor_n)
    cables = [c for c in np.argsort(-np.abs(size_n)) if clear[c]][:_NAMED_CABLES]
    if cables:
        items = [
            f"{_plain(arm.cable_names[c])} by {size_n[c]:+.2g} N "
            f"at {recording.time_s[step_rows[c] + 1]:.0f} s"
            for c in cables
        ]
        yield f"It changes once and stays: {listed(items)}. Check what slipped or was moved then."


def _jumps(recording: Recording, residual_n: Array, floor_n: float, arm: Arm) -> Iterator[str]:
    """Cables that jump more than once between rows of one command and load, most jumps first."""
    at_m = np.zeros(0) if recording.load_at_m is None else np.nan_to_num(recording.load_at_m)
    loads = recording.load_n, at_m.reshape(len(recording), -1)
    state = np.concatenate([recording.command_rad, *loads], axis=1)
    still = (np.diff(state, axis=0) == 0.0).all(1) & (np.diff(recording.trial) == 0)
    change = np.pad(np.diff(residual_n, axis=0), ((1, 1), (0, 0)))
    change_here = change[1:-1]
    size = np.abs(change[1:-1])
    beside = np.stack([change[:-2], change[2:]])
    late = ((np.sign(beside) == np.sign(change_here)) & (np.abs(beside) > _LATE_SHARE * size)).any(
        0
    )
    settled = still & np.append(False, still[:-1])
    far = settled[:, None] & (size > _JUMP_FLOORS * floor_n) & ~late
    count = far.sum(0)
    cables = [c for c in np.argsort(-count, kind="stable") if count[c] > 1][:_NAMED_CABLES]
    if cables:
        items = [
            f"{count[c]} times in {_plain(arm.cable_names[c])} "
            f"(by {np.median(size[far[:, c], c]):.2g} N)"
            for c in cables
        ]
        yield (
            f"It jumps while nothing moves: {listed(items)}. Check sensors, wiring and "
            "electronics, and parts that stick and slip."
        )


def _plain(name: str) -> str:
    return name.replace("_", " ")


def repeat_largest_trial(recording: Recording, residual_n: Array, floor_n: float) -> str:
    """How to repeat and vary the trial where the residual (R, M) is largest, as text.

    Both hold the rows that count. Trials of less than ten rows are left out.
    """
    sizes = {
        int(t): float(np.sqrt((residual_n[recording.trial == t] ** 2).mean()))
        for t in np.unique(recording.trial)
        if (recording.trial == t).sum() >= _TRIAL_ROWS
    }
    if not sizes:
        return ONE_AT_A_TIME
    trial = max(sizes, key=lambda t: sizes[t])
    done, again = _done_and_again(recording.rows(recording.trial == trial))
    return (
        f"Repeat trial {trial}, which has the largest residual: {done}. It leaves "
        f"{sizes[trial]:.2g} N, {short(sizes[trial] / floor_n)} times the noise floor. {again} "
        "Watch and touch the arm meanwhile."
    )


def _done_and_again(rows: Recording) -> tuple[str, str]:
    """The load or motion of one trial, and variations of it."""
    bent = np.abs(rows.command_rad).max()
    pose = "arm straight"
    if bent > BENT_RAD:
        pose = f"arm bent as in the recording (up to {np.rad2deg(bent):.2g} degrees)"
    size = np.linalg.norm(rows.load_n, axis=1)
    if size.max() > 0.0:
        peak = int(size.argmax())
        direction = rows.load_n[peak] / size[peak]
        half = 0.5**0.5
        sides = {**DIRECTIONS, "up": (0.0, 0.0, 1.0), "up and to the left": (0.0, half, half)}
        along = {name: float(np.dot(side, direction)) for name, side in sides.items()}
        side = max(along, key=lambda name: along[name])
        if along[side] <= _SAME_SIDE_COSINE:
            numbers = ", ".join(f"{part:.2f}" for part in direction)
            side = f"along ({numbers}) of the base frame"
        return (
            f"load segment {rows.load_segment[peak]}{_place(rows, peak)} {side} up to "
            f"{size[peak]:.2g} N, {pose}",
            "Then load it to half the force, at half the speed, and from the opposite side. A "
            "residual that grows faster than the load is not elastic. One that grows with time is "
            "creep. One that is not opposite on the opposite side is friction, a contact or a "
            "wrong measurement.",
        )
    moved = np.ptp(rows.command_rad, axis=0)
    if moved.max() > 0.0:
        joints = np.flatnonzero(moved > 0.5 * moved.max()) // 2 + 1
        named = ", ".join(str(j) for j in dict.fromkeys(joints.tolist()))
        which = f"joint {named}" if "," not in named else f"joints {named}"
        return (
            f"move {which} over {np.rad2deg(moved.max()):.2g} degrees",
            "Then move one joint at a time, at half the speed, and once back and forth with "
            "stops. A residual that is the same from both sides depends on the pose. One that "
            "depends on the direction of approach is friction or backlash.",
        )
    return (
        f"leave the arm at rest, {pose}",
        "Then do so for ten minutes. A residual that drifts is in the sensors or is creep. A "
        "constant one is a sensor zero, a weight or a pretension.",
    )


def _place(rows: Recording, row: int) -> str:
    """Where the load of a row acts, if that is stated."""
    at_m = np.nan if rows.load_at_m is None else float(rows.load_at_m[row])
    return "" if np.isnan(at_m) else f", {1e3 * at_m:.0f} mm from its joint,"
