"""Finding a channel that stands still while the others move."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cablesense_ros.can.channel_map import StuckLimits

Array = NDArray[np.float64]


class StuckWatch:
    """Tells which readings are stuck.

    A resting arm's readings may well stay the same to the last bit, as noise can be smaller than
    the converter's step: standing still alone is no fault. Standing still for `after_s` while half
    of the other channels have moved by more than `others_moved_n` is. A channel once found stuck
    stays so until its reading changes.
    """

    def __init__(self, channel_count: int, limits: StuckLimits) -> None:
        self._limits = limits
        self._last_n: Array = np.full(channel_count, np.nan)
        self._since_s = np.zeros(channel_count)
        self._then_n = np.zeros((channel_count, channel_count))
        self._stuck = np.zeros(channel_count, dtype=bool)
        self._needed = max(1, -(-(channel_count - 1) // 2))

    def stuck(self, tensions_n: Array, time_s: float) -> tuple[int, ...]:
        """Positions of the channels that are stuck in this sample.

        Args:
            tensions_n: (M,) readings of a whole sample.
            time_s: its time, ascending.
        """
        changed = tensions_n != self._last_n
        self._last_n = tensions_n.copy()
        self._since_s[changed] = time_s
        self._then_n[changed] = tensions_n
        self._stuck[changed] = False
        still = time_s - self._since_s >= self._limits.after_s
        if still.any():
            moved = np.abs(tensions_n - self._then_n[still]) > self._limits.others_moved_n
            self._stuck[still] |= moved.sum(axis=1) >= self._needed
        if not self._stuck.any():
            return ()
        return tuple(np.flatnonzero(self._stuck).tolist())

    def restart(self) -> None:
        """Forget what was, after a time without samples."""
        self._last_n = np.full_like(self._last_n, np.nan)
        self._stuck[:] = False
