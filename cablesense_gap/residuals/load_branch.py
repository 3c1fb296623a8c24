"""Loading against unloading: what the load last did, and how far apart both ways lie."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.recordings.recording import Recording

Array = NDArray[np.float64]

BRANCHES = ("before the load", "loading", "unloading", "after the load")
TOLERANCE = 0.05
"""Share of a trial's peak by which a measured load must move before it counts as moved."""


def load_branch(recording: Recording) -> NDArray[np.int64]:
    """Position (R,) in `BRANCHES`, -1 in trials without a load."""
    size = np.linalg.norm(recording.load_n, axis=-1)
    branch = np.full(len(recording), -1)
    for trial in np.unique(recording.trial):
        rows = np.flatnonzero(recording.trial == trial)
        if size[rows].max() > 0.0:
            branch[rows] = _branches(size[rows])
    return branch


def loop_n(recording: Recording, residual_n: Array) -> Array:
    """Half the residual's difference (L, M) between loading and unloading, at L equal levels.

    What friction leaves behind, and nothing that depends on the load alone.
    """
    size, branch = np.linalg.norm(recording.load_n, axis=-1), load_branch(recording)
    found = []
    for trial in np.unique(recording.trial[branch >= 0]):
        here = recording.trial == trial
        level = np.round(size / (TOLERANCE * size[here].max())).astype(int)
        for at in np.unique(level[here]).tolist():
            ways = [here & (level == at) & np.isin(branch, which) for which in ((0, 1), (2, 3))]
            if all(way.any() for way in ways):
                up, down = (residual_n[way].mean(axis=0) for way in ways)
                found.append((up - down) / 2.0)
    return np.array(found).reshape(-1, residual_n.shape[1])


def _branches(size: Array) -> NDArray[np.int64]:
    """Branches of one trial, by the load's last move beyond the tolerance."""
    step = TOLERANCE * float(size.max())
    branch = np.zeros(len(size), dtype=np.int64)
    extreme, rising = float(size[0]), bool(size[0] > step)
    for i, value in enumerate(size.tolist()):
        if (value - extreme) * (1.0 if rising else -1.0) >= 0.0:
            extreme = value
        elif abs(value - extreme) > step:
            extreme, rising = value, not rising
        if value > step:
            branch[i] = 1 if rising else 2
        else:
            branch[i] = 3 if (branch[:i] > 0).any() else 0
    return branch
