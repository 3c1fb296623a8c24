"""What to record where no listed effect explains the gap: the trial that shows most of it, varied.

How a gap answers to the size of a load, to its duration and to its direction tells elasticity,
creep, friction and measurement apart, whatever the cause is called.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.experiments import Experiment
from cablesense_gap.recordings.protocol import DIRECTIONS
from cablesense_gap.recordings.recording import Recording

Array = NDArray[np.float64]

FEWEST_ROWS = 10
SIDES = {**DIRECTIONS, "up": (0.0, 0.0, 1.0), "up and to the left": (0.0, 0.5**0.5, 0.5**0.5)}
_BENT_RAD = float(np.deg2rad(1.5))


def closer_look(recording: Recording, residual_n: Array, floor_n: float) -> Experiment:
    """The trial of a recording where the residual (R, M) is largest, and how to repeat it.

    Both hold the rows that count.

    Raises:
        ValueError: no trial has ten rows.
    """
    sizes = {
        int(t): float(np.sqrt((residual_n[recording.trial == t] ** 2).mean()))
        for t in np.unique(recording.trial)
        if (recording.trial == t).sum() >= FEWEST_ROWS
    }
    if not sizes:
        raise ValueError(f"no trial has {FEWEST_ROWS} rows")
    trial = max(sizes, key=lambda t: sizes[t])
    rms_n = sizes[trial]
    done, again = _told(recording.rows(recording.trial == trial))
    text = (
        f"Repeat what shows most of it, trial {trial}: {done}. There {rms_n:.2g} N are left, "
        f"{_short(rms_n / floor_n)} times the noise floor. {again} Watch and touch the arm "
        "meanwhile."
    )
    return Experiment(text, f"{done[0].upper()}{done[1:]}.", rms_n, rms_n / floor_n)


def _told(rows: Recording) -> tuple[str, str]:
    """What was done in one trial, and how to vary it."""
    size = np.linalg.norm(rows.load_n, axis=1)
    if size.max() > 0.0:
        peak = int(size.argmax())
        side = _side(rows.load_n[peak] / size[peak])
        return (
            f"load segment {rows.load_segment[peak]} {side} up to {size[peak]:.2g} N, "
            f"{_pose(rows)}",
            "Then load it half as far, twice as slowly, and from the opposite side: what grows "
            "faster than the load is no spring, what grows with time creeps, and what is not "
            "opposite on the opposite side rubs, touches or is measured wrong.",
        )
    moved = np.ptp(rows.command_rad, axis=0)
    if moved.max() > 0.0:
        joints = np.flatnonzero(moved > 0.5 * moved.max()) // 2 + 1
        named = ", ".join(str(j) for j in dict.fromkeys(joints.tolist()))
        which = f"joint {named}" if "," not in named else f"joints {named}"
        return (
            f"move {which} by {np.rad2deg(moved.max()):.2g} degrees in all",
            "Then move one joint at a time, twice as slowly, and once forth and back with stops: "
            "what stays at a stop belongs to the pose, what depends on the way there rubs or has "
            "play.",
        )
    return (
        f"leave the arm alone, {_pose(rows)}",
        "Then do so for ten minutes: what wanders is in the sensors or creeps, what stays is a "
        "zero, a weight or a tension.",
    )


def _side(direction: Array) -> str:
    names = list(SIDES)
    along = np.array([SIDES[name] for name in names]) @ direction
    if along.max() > 0.9:
        return names[int(along.argmax())]
    listed = ", ".join(f"{part:.2f}" for part in direction)
    return f"along ({listed}) of the base frame"


def _pose(rows: Recording) -> str:
    bent = np.abs(rows.command_rad).max()
    if bent <= _BENT_RAD:
        return "arm straight"
    return f"arm bent as then (up to {np.rad2deg(bent):.2g} degrees)"


def _short(value: float) -> str:
    return f"{value:.0f}" if value >= 10.0 else f"{value:.2g}"
