"""Dry friction as a state between -1 and 1 that follows a sliding distance and holds at rest."""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Onset(StrEnum):
    """How friction builds up before it slides."""

    SHARP = "sharp"
    ROUNDED = "rounded"


def follow(onset: Onset, state: Array, moved: Array, reach: float) -> tuple[Array, Array]:
    """New state and its derivative by the distance moved since the state was left.

    Sharp friction is a spring of `reach` that then slides (Prandtl 1928); rounded friction nears
    its full value as exp(-moved / reach) (Dahl 1968). Neither knows time: what does not move keeps
    its state.
    """
    if onset is Onset.SHARP:
        free = state + moved / reach
        return np.clip(free, -1.0, 1.0), (np.abs(free) < 1.0) / reach
    full = np.sign(moved)
    remaining = (full - state) * np.exp(-np.abs(moved) / reach)
    new = np.where(moved == 0.0, state, full - remaining)
    slope = np.where(moved == 0.0, 1.0, np.abs(remaining)) / reach
    return new, slope
