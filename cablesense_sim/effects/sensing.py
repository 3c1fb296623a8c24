"""What lies between the tension at an actuator and what its sensor reads."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Sensing:
    """Base: a perfect sensor. Holds its own state, for P arms side by side."""

    def step(self, time_s: float, tensions_n: Array) -> Array:
        """Readings (P, M) of tensions (P, M) at the next moment."""
        return tensions_n
