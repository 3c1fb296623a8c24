"""Channels that drop out and repeat their last value until they are back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Freezing:
    """Dropouts of M channels.

    Attributes:
        share: (M,) of the rows in which a channel is frozen.
        mean_rows: how long a dropout lasts on average.
        seed: of when they come.
    """

    share: Array
    mean_rows: float = 20.0
    seed: int = 0

    def held_n(self, signal_n: Array) -> Array:
        """(R, M) signals with the last value before each dropout held through it."""
        if not self.share.any():
            return signal_n
        rng = np.random.default_rng(self.seed)
        rows = len(signal_n)
        last = np.tile(np.arange(rows)[:, None], (1, len(self.share)))
        for channel in np.flatnonzero(self.share):
            gap = self.mean_rows * (1.0 / self.share[channel] - 1.0)
            at = 1.0 + rng.exponential(gap)
            while at < rows:
                end = at + 1.0 + rng.exponential(self.mean_rows)
                last[int(at) : int(end), channel] = int(at) - 1
                at = end + 1.0 + rng.exponential(gap)
        return np.take_along_axis(signal_n, last, axis=0)
