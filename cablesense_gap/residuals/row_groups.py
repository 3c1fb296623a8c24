"""The rows of a recording by what the arm was doing: load, pose, motion, time, trial."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.recordings.recording import Recording
from cablesense_gap.residuals.load_branch import BRANCHES, load_branch

Rows = NDArray[np.bool_]

LOADED, POSE, JOINT, LEVEL, BRANCH, MOTION, TIME, TRIAL = (
    "loaded segment",
    "pose",
    "joint bent most",
    "load level",
    "loading and unloading",
    "rest and motion",
    "time",
    "trial",
)
REGIMES = (LOADED, POSE, JOINT, LEVEL, BRANCH, MOTION, TIME)
"""The groups that name a regime; trials only say when."""

BENT_RAD = float(np.deg2rad(1.5))
"""A joint bent by less counts as straight: the small reversals of the protocol stay below."""
MOVED_RAD = 1e-5


def row_groups(recording: Recording) -> Iterator[tuple[str, str, Rows]]:
    """Group, member and its rows (R,), members of a group apart from each other."""
    yield from _loads(recording)
    yield from _poses(recording)
    branch = load_branch(recording)
    for i, name in enumerate(BRANCHES):
        yield BRANCH, name, branch == i
    moving = _moving(recording)
    yield MOTION, "at rest", ~moving
    yield MOTION, "moving", moving
    elapsed = recording.time_s - recording.time_s[0]
    third = np.minimum((3.0 * elapsed / max(float(elapsed[-1]), 1e-9)).astype(int), 2)
    for i, name in enumerate(("early", "middle", "late")):
        yield TIME, name, third == i
    for trial in np.unique(recording.trial).tolist():
        yield TRIAL, f"trial {trial}", recording.trial == trial


def _loads(recording: Recording) -> Iterator[tuple[str, str, Rows]]:
    segment = recording.load_segment
    yield LOADED, "no load", segment == 0
    for n in range(1, recording.command_rad.shape[1] // 2 + 1):
        yield LOADED, f"segment_{n}", segment == n
    size = np.linalg.norm(recording.load_n, axis=-1)
    third_n = float(size.max()) / 3.0
    if third_n == 0.0:
        return
    for low, high in pairwise((0.0, third_n, 2.0 * third_n, np.inf)):
        name = f"{low:.0f} to {high:.0f} N" if high < np.inf else f"above {low:.0f} N"
        yield LEVEL, name, (segment > 0) & (size > low) & (size <= high)


def _poses(recording: Recording) -> Iterator[tuple[str, str, Rows]]:
    pitch_yaw = recording.command_rad.reshape(len(recording), -1, 2)
    bend = np.linalg.norm(pitch_yaw, axis=-1)
    bent, most = bend.max(axis=1) > BENT_RAD, bend.argmax(axis=1)
    yield POSE, "straight", ~bent
    yield POSE, "bent", bent
    for n in range(bend.shape[1]):
        yield JOINT, f"joint_{n + 1}", bent & (most == n)


def _moving(recording: Recording) -> Rows:
    """Rows whose command differs from that of the row before or after, in the same trial."""
    step = np.abs(np.diff(recording.command_rad, axis=0)).max(axis=1) > MOVED_RAD
    step &= np.diff(recording.trial) == 0
    return np.append(step, False) | np.append(False, step)
