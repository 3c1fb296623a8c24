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

_LEAST_STD = 1e-9
"""Deviation of a slide that is known: something is divided by it."""


class Belief(NamedTuple):
    """What is known of the machine at one sample: mean (P,) and covariance (P, P)."""

    mean: Array
    covariance: Array


class Slides(NamedTuple):
    """What is known of the slides of M cables at their G guides, from the actuators on.

    Attributes:
        mean: (G, M), from -1 to 1.
        std: (G, M), independent of one another.
    """

    mean: Array
    std: Array


class KnownLengths(NamedTuple):
    """Lengths of cable, as well as they are known.

    Attributes:
        mean_m: the lengths.
        std_m: how far off they may be.
    """

    mean_m: Array
    std_m: Array


class _Clipped(NamedTuple):
    """Moments of a normal number that is held between -1 and 1.

    Attributes:
        mean: its mean.
        square: the mean of its square.
    """

    mean: Array
    square: Array


def played(slides: Slides, passed: KnownLengths, play_m: Array) -> Slides:
    """Slides (G, M) after cable has passed, by the play that each guide has (G, M).

    `passed` (G, M) is what would have passed without friction, towards the arm if positive. Where
    cable sticks nothing passes, and friction takes up what else would: the slide u goes to

        u' = u + 2 x / X,    held between -1 and 1,

    with what would have passed x and the play X over which u goes from -1 to 1 (`play_m`). This is
    the play operator of a spring with Coulomb friction (Visintin, Differential Models of
    Hysteresis, 1994). Before it, u is 1 or -1, where cable slid one way or the other, or
    the mean where it stuck, with the probabilities that give its mean and variance.
    """
    moved = 2.0 * passed.mean_m / play_m
    std = np.maximum(2.0 * passed.std_m / play_m, _LEAST_STD)
    slid = np.minimum(slides.std**2 / np.maximum(1.0 - slides.mean**2, _LEAST_STD), 1.0)
    forth = _clipped(1.0 + moved, std)
    back = _clipped(moved - 1.0, std)
    stuck = _clipped(slides.mean + moved, std)
    forth_probability = 0.5 * slid * (1.0 + slides.mean)
    back_probability = 0.5 * slid * (1.0 - slides.mean)
    stuck_probability = 1.0 - slid
    mean = (
        forth_probability * forth.mean
        + back_probability * back.mean
        + stuck_probability * stuck.mean
    )
    square = (
        forth_probability * forth.square
        + back_probability * back.square
        + stuck_probability * stuck.square
    )
    variance = np.maximum(square - mean**2, SLIDING_STD**2)
    return Slides(mean, np.sqrt(variance))


def play_compliance_m_n(compliance_m_n: Array) -> Array:
    """(M, G) half the play of guides by the tension that they hold, of pieces (M, G + 1).

    A guide that holds a tension parts two springs, the pieces before it and those behind it. So
    much cable has to pass that both together give that tension: a compliance in series.
    """
    before_m_n = compliance_m_n.cumsum(axis=1)[:, :-1]
    behind_m_n = compliance_m_n.sum(axis=1, keepdims=True) - before_m_n
    return before_m_n * behind_m_n / (before_m_n + behind_m_n)


def _clipped(mean: Array, std: Array) -> _Clipped:
    """Moments of normal numbers of these means and deviations, held between -1 and 1.

    With the density φ and the probability Φ of the standard normal number, α = (-1 - m) / s and
    β = (1 - m) / s:

        E[u] = m (Φ(β) - Φ(α)) + s (φ(α) - φ(β)) + 1 - Φ(β) - Φ(α)
        E[u²] = (m² + s²) (Φ(β) - Φ(α)) + s ((m - 1) φ(α) - (m + 1) φ(β)) + 1 - Φ(β) + Φ(α)
    """
    low = (-1.0 - mean) / std
    high = (1.0 - mean) / std
    below = _probability_below(low)
    above = 1.0 - _probability_below(high)
    between = 1.0 - below - above
    low_density = _density(low)
    high_density = _density(high)
    by_density = (mean - 1.0) * low_density - (mean + 1.0) * high_density
    return _Clipped(
        mean=mean * between + std * (low_density - high_density) + above - below,
        square=(mean**2 + std**2) * between + std * by_density + above + below,
    )


def _density(values: Array) -> Array:
    """Of the standard normal number."""
    return np.exp(-0.5 * values**2) / math.sqrt(2.0 * math.pi)


def _probability_below(values: Array) -> Array:
    """That the standard normal number is below; NumPy has no error function."""
    return np.vectorize(math.erfc, otypes=[float])(-values / math.sqrt(2.0)) / 2.0
