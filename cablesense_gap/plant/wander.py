"""Zeros of sensors that wander with time."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Course(StrEnum):
    """How a zero wanders."""

    LINEAR = "linear"
    SINE = "slow sine"
    WALK = "random walk"
    WARM_UP = "warm-up"


@dataclass(frozen=True)
class Wander:
    """A course that the zeros of M sensors share in different sizes.

    Attributes:
        size_n: (M,) how far each goes within a recording, either way.
        course: which.
        time_s: period of a sine, time constant of a warm-up.
        phase_rad: of the sine.
        seed: of the walk.
    """

    size_n: Array
    course: Course = Course.LINEAR
    time_s: float = 100.0
    phase_rad: float = 0.0
    seed: int = 0

    def zeros_n(self, time_s: Array) -> Array:
        """(R, M) zeros at times (R,)."""
        if not self.size_n.any():
            return np.zeros((len(time_s), len(self.size_n)))
        since = time_s - time_s[0]
        match self.course:
            case Course.LINEAR:
                shape = since[:, None] / since[-1] * np.ones_like(self.size_n)
            case Course.SINE:
                shape = np.sin(2.0 * np.pi * since / self.time_s + self.phase_rad)[:, None]
            case Course.WARM_UP:
                shape = 1.0 - np.exp(-since / self.time_s)[:, None]
            case Course.WALK:
                steps = np.random.default_rng(self.seed).standard_normal(
                    (len(time_s), len(self.size_n))
                )
                walk = np.cumsum(steps, axis=0)
                shape = (walk - walk[0]) / np.abs(walk - walk[0]).max(axis=0)
        return shape * self.size_n
