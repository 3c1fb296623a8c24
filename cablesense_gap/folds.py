"""Which trials of a recording are held out together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.recordings.recording import Recording

FOLDS = 5


def folds_of(recording: Recording) -> NDArray[np.int64]:
    """(T,) fold 0 to 4 of each trial, in the order of their numbers.

    Trials of one kind, by the segment that is loaded and by whether the arm moves, are dealt
    to the folds in turn, so that each fold leaves some of every kind to fit to.
    """
    kinds: dict[tuple[int, bool], list[int]] = {}
    for t, number in enumerate(np.unique(recording.trial)):
        rows = recording.trial == number
        moves = bool((np.ptp(recording.command_rad[rows], axis=0) > 0.0).any())
        kinds.setdefault((int(recording.load_segment[rows].max()), moves), []).append(t)
    dealt = [t for kind in sorted(kinds) for t in kinds[kind]]
    fold = np.empty(len(dealt), dtype=np.int64)
    fold[dealt] = np.arange(len(dealt)) % min(FOLDS, len(dealt))
    return fold
