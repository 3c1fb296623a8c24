"""A gap that no listed effect explains: its pattern, and what to record to narrow it down.

A flexible model of what tolerances leave (`diagnosis.discrepancy`) sees features of what the arm
was doing. How a gap responds to the size of a load, to its duration and to its direction separates
elasticity, creep, friction and measurement, whatever the cause is called.
"""

from __future__ import annotations

import numpy as np

from cablesense_base import Array
from cablesense_gap.diagnosis.discrepancy import Features, discrepancy
from cablesense_gap.diagnosis.problem import Problem
from cablesense_gap.pipeline import Unlisted
from cablesense_gap.recordings.protocol import DIRECTIONS
from cablesense_gap.recordings.recording import Recording
from cablesense_gap.residual_patterns import residual_patterns
from cablesense_gap.verdict import short
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import held_lengths_m

_PLAYS = (0.05, 0.3)
"""Widths of the plays, as shares of a channel's range."""
_WAITED_S = 10.0
_FEWEST_ROWS = 10
_SIDES = {**DIRECTIONS, "up": (0.0, 0.0, 1.0), "up and to the left": (0.0, 0.5**0.5, 0.5**0.5)}
_BENT_RAD = float(np.deg2rad(1.5))
ONE_AT_A_TIME = (
    "Record again what the regimes above name, and change one thing at a time: "
    "`cablesense gap protocol` lists loads, poses and holds that part most effects."
)


def residual_features(recording: Recording, nominal_n: Array, arm: Arm) -> Features:
    """Features of the rows, beside the nominal prediction (R, M).

    pose: commanded angles. load: by segment and axis, and its magnitude. tension: of each cable in
    the nominal arm. motion: which way each cable is pulled. history: how far each cable's tension
    lags behind itself in a play, which depends on where it turned. time: since the recording
    began, and since the arm or its load last changed.
    """
    held_m, trial = held_lengths_m(mechanism_of(arm), recording.command_rad), recording.trial
    step_m = np.diff(held_m, axis=0, prepend=held_m[:1])
    step_m[np.diff(trial, prepend=trial[0]) != 0] = 0.0
    forces_n = recording.forces_n
    loads_n = forces_n.reshape(len(recording), -1)
    size_n = np.linalg.norm(forces_n, axis=-1).sum(-1)
    state = np.concatenate([recording.command_rad, loads_n], axis=1)
    changed = (np.diff(state, axis=0, prepend=state[:1]) != 0.0).any(axis=1)
    last = np.maximum.accumulate(np.where(changed, np.arange(len(state)), 0))
    waited_s = recording.time_s - recording.time_s[last]
    segments = range(1, forces_n.shape[1] + 1)
    cables = arm.cable_names
    parts = {
        "pose": (recording.command_rad, [f"{name} commanded" for name in arm.joint_names]),
        "load": (
            np.column_stack([loads_n, size_n]),
            [f"load on segment_{n} along {axis}" for n in segments for axis in "xyz"]
            + ["size of the load"],
        ),
        "tension": (nominal_n, [f"tension of {name}" for name in cables]),
        "motion": (
            np.sign(np.where(np.abs(step_m) > 1e-9, step_m, 0.0)),
            [f"motion of {name}" for name in cables],
        ),
        "history": (
            np.concatenate([_behind(nominal_n, share) for share in _PLAYS], axis=1),
            [f"turning points of {name}" for _ in _PLAYS for name in cables],
        ),
        "time": (
            np.column_stack([recording.time_s, np.exp(-waited_s / _WAITED_S)]),
            ["time", "time since the last change"],
        ),
    }
    return Features(
        values=np.concatenate([values for values, _ in parts.values()], axis=1),
        names=tuple(name for _, names in parts.values() for name in names),
        groups=tuple(group for group, (_, names) in parts.items() for _ in names),
    )


def _behind(signal: Array, share: float) -> Array:
    """How far the signal is from the middle of a play that follows it, in half widths, -1 to 1."""
    half = np.maximum(share * np.ptp(signal, axis=0), 1e-9)
    middle = signal[0].copy()
    found = np.empty_like(signal)
    for row, value in enumerate(signal):
        middle = np.clip(middle, value - half, value + half)
        found[row] = (value - middle) / half
    return found


def repeat_largest_trial(recording: Recording, residual_n: Array, floor_n: float) -> str:
    """How to repeat and vary the trial where the residual (R, M) is largest, as text.

    Both hold the rows that count; trials of less than ten rows do not.
    """
    sizes = {
        int(t): float(np.sqrt((residual_n[recording.trial == t] ** 2).mean()))
        for t in np.unique(recording.trial)
        if (recording.trial == t).sum() >= _FEWEST_ROWS
    }
    if not sizes:
        return ONE_AT_A_TIME
    trial = max(sizes, key=lambda t: sizes[t])
    done, again = _done_and_again(recording.rows(recording.trial == trial))
    return (
        f"Repeat what shows most of it, trial {trial}: {done}. There {sizes[trial]:.2g} N are "
        f"left, {short(sizes[trial] / floor_n)} times the noise floor. {again} Watch and touch "
        "the arm meanwhile."
    )


def _done_and_again(rows: Recording) -> tuple[str, str]:
    """What was done in one trial, and how to vary it."""
    bent = np.abs(rows.command_rad).max()
    pose = "arm straight"
    if bent > _BENT_RAD:
        pose = f"arm bent as then (up to {np.rad2deg(bent):.2g} degrees)"
    size = np.linalg.norm(rows.load_n, axis=1)
    if size.max() > 0.0:
        peak = int(size.argmax())
        direction = rows.load_n[peak] / size[peak]
        along = {name: float(np.dot(side, direction)) for name, side in _SIDES.items()}
        side = max(along, key=lambda name: along[name])
        if along[side] <= 0.9:
            listed = ", ".join(f"{part:.2f}" for part in direction)
            side = f"along ({listed}) of the base frame"
        return (
            f"load segment {rows.load_segment[peak]} {side} up to {size[peak]:.2g} N, {pose}",
            "Then load it half as far, twice as slowly, and from the opposite side: what grows "
            "faster than the load is no spring, what grows with time creeps, and what is not "
            "opposite on the opposite side is friction, contact or a wrong measurement.",
        )
    moved = np.ptp(rows.command_rad, axis=0)
    if moved.max() > 0.0:
        joints = np.flatnonzero(moved > 0.5 * moved.max()) // 2 + 1
        named = ", ".join(str(j) for j in dict.fromkeys(joints.tolist()))
        which = f"joint {named}" if "," not in named else f"joints {named}"
        return (
            f"move {which} by {np.rad2deg(moved.max()):.2g} degrees in all",
            "Then move one joint at a time, twice as slowly, and once forth and back with stops: "
            "what stays at a stop belongs to the pose, what depends on the way there is "
            "friction or play.",
        )
    return (
        f"leave the arm alone, {pose}",
        "Then do so for ten minutes: what wanders is in the sensors or creeps, what stays is a "
        "zero, a weight or a tension.",
    )


def describe_unlisted(
    problem: Problem, residual: Array, recording: Recording, arm: Arm
) -> Unlisted:
    """The pattern of a held-out residual (R, M), as a flexible model without physics sees it."""
    features = residual_features(recording, problem.nominal, arm)
    found = discrepancy(
        features, residual, problem.trial, problem.fold, problem.used, problem.floor
    )
    rows, left = recording.rows(problem.used), residual[problem.used]
    reasons = (
        f"A flexible model, which knows commands, loads, directions and time but no physics, "
        f"explains {max(found.explained_share, 0.0):.0%} of what is left on such trials.",
        *residual_patterns(rows, left, found, arm, problem.floor),
    )
    experiment = repeat_largest_trial(rows, left, problem.floor)
    return Unlisted(reasons, experiment, found.held_out)
