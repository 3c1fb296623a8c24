"""The slides of cables at their guides, which say what friction adds to their tensions.

At a guide with the wrap Φ the tension towards the arm is exp(u μ Φ) times that towards the
actuator, with the slide u between -1 and 1. It is 1 where cable last slid towards the arm, -1
where it slid back, and anything between where it sticks.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cablesense_base import Array

SLIDING_STD = 0.1
"""Deviation of the slide where cable has slid: the last of the way may have been back."""

_LEAST_STD_M = 1e-15
"""Deviation of a length that is known: something is divided by it."""


class Belief(NamedTuple):
    """What is known of the machine at one sample: mean (P,) and covariance (P, P)."""

    mean: Array
    covariance: Array


class Slides(NamedTuple):
    """What is known of the slides of M cables at their G guides, from the actuators on.

    Attributes:
        mean: (G, M), from -1 to 1.
        std: (G, M), independent of one another, and
        common: (G, M) what all are off by together, times a standard normal number.
    """

    mean: Array
    std: Array
    common: Array


def turned(
    slides: Slides, passed_m: Array, turning_m: Array, passed_std_m: Array | None = None
) -> Slides:
    """Slides (G, M) after lengths (G, M) of cable have passed: towards the arm if positive.

    The way over which a cable turns is known roughly: the chance that it has not yet turned falls
    exponentially with what has passed. Where that is known with a standard deviation (G, M) only,
    its direction is, too: the mean slide is then the chance of one way less that of the other.
    """
    std_m = np.zeros_like(passed_m) if passed_std_m is None else passed_std_m
    kept = np.exp(-np.hypot(passed_m, std_m) / turning_m)
    square = kept * (slides.std**2 + slides.mean**2) + (1.0 - kept) * (1.0 + SLIDING_STD**2)
    # erf(x / (σ √2)) is the chance that a normal number of mean x is positive, less the other
    direction = _erf(passed_m / np.maximum(math.sqrt(2.0) * std_m, _LEAST_STD_M))
    mean = kept * slides.mean + (1.0 - kept) * direction
    return Slides(mean, np.sqrt(square - mean**2), slides.common)


def _erf(values: Array) -> Array:
    """The error function of each; NumPy has none."""
    return np.vectorize(math.erf, otypes=[float])(values)
