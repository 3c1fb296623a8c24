"""Where cables slide at their guides, as changes of the readings tell.

A cable whose reading changes slides at its guides in the direction of the change. What friction
adds to its tension is then known but for the coefficient. A cable that has not moved since it was
last untouched may carry anything that friction holds, and one at which the load has turned back
keeps its tension until it slips back.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_sim.tolerances import ArmParameters

MOVED_STD = 5.0
"""A cable has moved if its reading has changed by this many deviations of a reading."""
_SLIDING_STD = 0.15
"""Deviation of the slide of a cable that has moved: farther guides may lag behind."""
_FREED_STD = 0.05
"""Deviation of slides after a breath."""

Directions = NDArray[np.int8]
"""Of cables that slide: 1 where readings rise, -1 where they fall, 0 where neither is known."""


class Belief(NamedTuple):
    """What is known of the arm at one sample: mean (P,) and covariance (P, P)."""

    mean: Array
    covariance: Array


class CableSlides:
    """The slides among the P parameters of an arm with M cables."""

    def __init__(self, parameters: ArmParameters) -> None:
        """Find them."""
        at = parameters.slices
        guides = [part for name, part in at.items() if name.startswith("slide")]
        self._rows = np.array([np.arange(part.start, part.stop) for part in guides])
        self._exists = parameters.prior_std[self._rows] > 0.0

    def sliding(self, known: Belief, direction: Directions) -> Belief:
        """What is known where cables (M,) slide in these directions; the others' slides stay."""
        moved = np.flatnonzero(direction)
        return self._with_slides(known, moved, direction[moved].astype(float), _SLIDING_STD)

    def freed(self, known: Belief) -> Belief:
        """What is known after a breath has taken friction out of the readings of all cables."""
        every = np.arange(self._rows.shape[1])
        return self._with_slides(known, every, np.zeros(len(every)), _FREED_STD)

    def _with_slides(
        self, known: Belief, cables: NDArray[np.int64], slide: Array, std: float
    ) -> Belief:
        """What is known with other slides (K,) of some cables (K,) at all their guides."""
        if not len(cables):
            return known
        mean = known.mean.copy()
        covariance = known.covariance.copy()
        exists = self._exists[:, cables]
        rows = self._rows[:, cables][exists]
        covariance[rows, :] = 0.0
        covariance[:, rows] = 0.0
        covariance[rows, rows] = std**2
        mean[rows] = np.broadcast_to(slide, exists.shape)[exists]
        return Belief(mean, covariance)


def directions_since(change_n: Array, moved_n: float) -> Directions:
    """Directions (M,) by changes (M,) since the arm was untouched; `moved_n` makes a movement."""
    return np.sign(change_n).astype(np.int8) * (np.abs(change_n) > moved_n)


def directions_along(readings_n: Array, untouched_n: Array, moved_n: float) -> Directions:
    """Directions (R, M) along readings (R, M) at one pose, from untouched ones (M,) on.

    The direction is that of the last movement, which a reading shows by `moved_n` from the
    outermost one in the direction before.
    """
    found = np.zeros(readings_n.shape, dtype=np.int8)
    direction = np.zeros(len(untouched_n), dtype=np.int8)
    outermost_n = untouched_n
    for row, reading_n in enumerate(readings_n):
        further = (reading_n - outermost_n) * direction > 0.0
        outermost_n = np.where(further, reading_n, outermost_n)
        turned = directions_since(reading_n - outermost_n, moved_n)
        outermost_n = np.where(turned != 0, reading_n, outermost_n)
        direction = np.where(turned != 0, turned, direction)
        found[row] = direction
    return found
