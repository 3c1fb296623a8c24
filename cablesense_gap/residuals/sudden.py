"""What comes at once: one lasting change of a channel, or jumps while nothing is done."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.recordings.recording import Recording

Array = NDArray[np.float64]

STEP_SHARE = 0.6
"""Of a channel's scatter, that one step must explain."""
STEP_FLOORS = 4.0
EDGE = 0.05
"""Share of the rows at either end where a step cannot be told from what a few rows have."""
JUMP_FLOORS = 8.0
FEWEST_JUMPS = 2
_AFTERMATH = 0.25
"""What goes on in the same direction by more than this share is no jump, but late."""


@dataclass(frozen=True)
class Step:
    """A channel that changed once and stayed."""

    channel: int
    time_s: float
    size_n: float


@dataclass(frozen=True)
class Jumps:
    """Jumps of one channel between rows of one command and one load."""

    channel: int
    count: int
    size_n: float


def steps(recording: Recording, residual_n: Array, floor_n: float) -> tuple[Step, ...]:
    """Channels of a residual (R, M) whose scatter is one step in time, the largest first."""
    rows = np.arange(1, len(residual_n))
    centred = residual_n - residual_n.mean(0)
    before = np.cumsum(centred, axis=0)[:-1]
    weight = (rows * (len(residual_n) - rows) / len(residual_n))[:, None]
    apart = -before * len(residual_n) / (rows * (len(residual_n) - rows))[:, None]
    explained = weight * apart**2 / np.maximum((centred**2).sum(0), 1e-12)
    inside = (rows > EDGE * len(residual_n)) & (rows < (1.0 - EDGE) * len(residual_n))
    explained[~inside] = 0.0
    at = explained.argmax(0)
    found = [
        Step(c, float(recording.time_s[row + 1]), float(apart[row, c]))
        for c, row in enumerate(at.tolist())
        if explained[row, c] >= STEP_SHARE and abs(apart[row, c]) >= STEP_FLOORS * floor_n
    ]
    return tuple(sorted(found, key=lambda step: -abs(step.size_n)))


def jumps(recording: Recording, residual_n: Array, floor_n: float) -> tuple[Jumps, ...]:
    """Channels of a residual (R, M) that jump while nothing is done, most jumps first."""
    state = np.concatenate([recording.command_rad, recording.load_n], axis=1)
    still = (np.diff(state, axis=0) == 0.0).all(1) & (np.diff(recording.trial) == 0)
    change = np.pad(np.diff(residual_n, axis=0), ((1, 1), (0, 0)))
    here, size = change[1:-1], np.abs(change[1:-1])
    beside = np.stack([change[:-2], change[2:]])
    goes_on = (np.sign(beside) == np.sign(here)) & (np.abs(beside) > _AFTERMATH * size)
    settled = still & np.append(False, still[:-1])
    far = settled[:, None] & (size > JUMP_FLOORS * floor_n) & ~goes_on.any(0)
    found = [
        Jumps(c, int(far[:, c].sum()), float(np.median(size[far[:, c], c])))
        for c in range(residual_n.shape[1])
        if far[:, c].sum() >= FEWEST_JUMPS
    ]
    return tuple(sorted(found, key=lambda each: -each.count))
