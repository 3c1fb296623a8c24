"""What lies between the commanded cable length and the one that an actuator holds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Actuation:
    """Base: passes the command on. Holds its own state, for P arms side by side."""

    def step(self, time_s: float, held_m: Array) -> Array:
        """Lengths (P, M) really held, given those commanded, at the next moment."""
        return held_m
