"""What the arm was doing in each row of a recording, as features that a residual may go with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.diagnosis.discrepancy import Features
from cablesense_gap.recordings.recording import Recording
from cablesense_sim.arm import Arm
from cablesense_sim.equilibrium import held_lengths_m
from cablesense_sim.mechanism import Mechanism

Array = NDArray[np.float64]

POSE, LOAD, TENSION, MOTION, HISTORY, TIME = (
    "pose", "load", "tension", "motion", "history", "time",
)  # fmt: skip
_PLAYS = (0.05, 0.3)
"""Widths of the plays, as shares of a channel's range."""
_WAITED_S = 10.0


def course_features(recording: Recording, nominal_n: Array, arm: Arm) -> Features:
    """Features of the rows, beside the nominal prediction (R, M).

    pose: commanded angles. load: by segment and axis, and its magnitude. tension: of each cable in
    the nominal arm. motion: which way each cable is pulled. history: how far each cable's tension
    lags behind itself in a play, which remembers where it turned. time: since the recording began,
    since the trial did, and since the arm or its load last changed.
    """
    held_m = held_lengths_m(Mechanism.from_arm(arm), recording.command_rad)
    trial = recording.trial
    parts = {
        POSE: (recording.command_rad, [f"{name} commanded" for name in arm.joint_names]),
        LOAD: (_loads(recording), _load_names(recording)),
        TENSION: (nominal_n, [f"tension of {name}" for name in arm.cable_names]),
        MOTION: (_directions(held_m, trial), [f"motion of {name}" for name in arm.cable_names]),
        HISTORY: (
            np.concatenate([_behind(nominal_n, share) for share in _PLAYS], axis=1),
            [f"turning points of {name}" for _ in _PLAYS for name in arm.cable_names],
        ),
        TIME: (_times(recording), ["time", "time since the last change"]),
    }
    return Features(
        values=np.concatenate([values for values, _ in parts.values()], axis=1),
        names=tuple(name for _, names in parts.values() for name in names),
        groups=tuple(group for group, (_, names) in parts.items() for _ in names),
    )


def _loads(recording: Recording) -> Array:
    forces = recording.forces_n
    size = np.linalg.norm(forces, axis=-1).sum(-1)
    return np.column_stack([forces.reshape(len(forces), -1), size])


def _load_names(recording: Recording) -> list[str]:
    count = recording.forces_n.shape[1]
    along = [f"load on segment_{n + 1} along {axis}" for n in range(count) for axis in "xyz"]
    return [*along, "size of the load"]


def _directions(held_m: Array, trial: NDArray[np.int64]) -> Array:
    """-1, 0 or 1: which way each length last moved between two rows of one trial."""
    step = np.diff(held_m, axis=0, prepend=held_m[:1])
    step[np.diff(trial, prepend=trial[0]) != 0] = 0.0
    return np.sign(np.where(np.abs(step) > 1e-9, step, 0.0))


def _behind(signal: Array, share: float) -> Array:
    """How far the signal is from the middle of a play that follows it, in half widths, -1 to 1."""
    half = np.maximum(share * np.ptp(signal, axis=0), 1e-9)
    middle = signal[0].copy()
    found = np.empty_like(signal)
    for row, value in enumerate(signal):
        middle = np.clip(middle, value - half, value + half)
        found[row] = (value - middle) / half
    return found


def _times(recording: Recording) -> Array:
    forces = recording.forces_n.reshape(len(recording), -1)
    state = np.concatenate([recording.command_rad, forces], axis=1)
    changed = (np.diff(state, axis=0, prepend=state[:1]) != 0.0).any(axis=1)
    changed[0] = True
    last_s = recording.time_s[np.maximum.accumulate(np.where(changed, np.arange(len(state)), 0))]
    waited_s = recording.time_s - last_s
    return np.column_stack([recording.time_s, np.exp(-waited_s / _WAITED_S)])
