"""What comes at once: one lasting change of a channel, or single rows that are far off."""

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
SPIKE_FLOORS = 8.0
FEWEST_SPIKES = 3


@dataclass(frozen=True)
class Step:
    """A channel that changed once and stayed."""

    channel: int
    time_s: float
    size_n: float


@dataclass(frozen=True)
class Spikes:
    """Rows of a channel that are far from both their neighbours."""

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


def spikes(recording: Recording, residual_n: Array, floor_n: float) -> tuple[Spikes, ...]:
    """Channels with some rows far to one side of the rows before and after; most spikes first.

    Rows beside a change of the load do not count: what is late is no spike.
    """
    one_load = (np.diff(recording.load_n, axis=0) == 0.0).all(1)
    alike = (recording.trial[2:] == recording.trial[:-2]) & one_load[1:] & one_load[:-1]
    to_both = np.stack([residual_n[1:-1] - residual_n[:-2], residual_n[1:-1] - residual_n[2:]])
    same_side = np.sign(to_both[0]) == np.sign(to_both[1])
    size = np.abs(to_both).min(0) * (same_side & alike[:, None])
    far = size > SPIKE_FLOORS * floor_n
    found = [
        Spikes(c, int(far[:, c].sum()), float(np.median(size[far[:, c], c])))
        for c in range(residual_n.shape[1])
        if far[:, c].sum() >= FEWEST_SPIKES
    ]
    return tuple(sorted(found, key=lambda each: -each.count))
