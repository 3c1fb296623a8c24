"""What a straight line leaves of a sensor: nonlinearity, hysteresis, repeatability.

The terms are those of VDI/VDE 2638 (characteristics of force transducers) and are given in N here.
The reference line is the fitted one, and the loads are those that there were; the standard's own
procedure, with its fixed load steps and mounting positions, is for a testing machine.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SAME_FORCE = 0.005
"""Forces that differ by less than this share of the largest are one load put on again."""


class Direction(Enum):
    """Whether a load was reached by adding weight or by taking weight away."""

    RISING = "rising"
    FALLING = "falling"


@dataclass(frozen=True)
class ResidualFigures:
    """All in N; none where the loads do not show it.

    Attributes:
        nonlinearity_n: largest distance of a rising load's mean reading from the line.
        hysteresis_n: largest difference of mean readings between falling and rising at one load.
        repeatability_n: largest range of readings at one load, reached from one side.
    """

    nonlinearity_n: float
    hysteresis_n: float | None
    repeatability_n: float | None


def residual_figures(force_n: Array, residual_n: Array) -> ResidualFigures:
    """The figures of (n,) loads in the order they were put on, and what the line leaves of each.

    The largest load belongs to both sides, as the end of one and the start of the other.
    """
    means: dict[tuple[int, Direction], float] = {}
    ranges = []
    loads = load_numbers(force_n)
    directions = _directions(force_n)
    top = int(loads[int(np.argmax(force_n))])
    for load in np.unique(loads).tolist():
        for direction in Direction:
            chosen = (loads == load) & np.array([d is direction for d in directions])
            if chosen.any():
                means[load, direction] = float(residual_n[chosen].mean())
            if chosen.sum() > 1:
                ranges.append(float(np.ptp(residual_n[chosen])))
    rising = [mean for (_, direction), mean in means.items() if direction is Direction.RISING]
    loops = [
        abs(mean - means[load, Direction.RISING])
        for (load, direction), mean in means.items()
        if direction is Direction.FALLING and load != top and (load, Direction.RISING) in means
    ]
    return ResidualFigures(
        nonlinearity_n=max(abs(mean) for mean in rising or means.values()),
        hysteresis_n=max(loops, default=None),
        repeatability_n=max(ranges, default=None),
    )


def load_numbers(force_n: Array) -> NDArray[np.int64]:
    """(n,) which of the different loads each is, from 0 for the smallest."""
    order = np.argsort(force_n, kind="stable")
    new = np.diff(force_n[order]) > SAME_FORCE * max(float(force_n.max()), 1e-12)
    numbers = np.empty(len(force_n), dtype=np.int64)
    numbers[order] = np.concatenate([[0], np.cumsum(new)])
    return numbers


def _directions(force_n: Array) -> list[Direction]:
    loads = load_numbers(force_n)
    found = [Direction.RISING]
    for step in np.diff(loads).tolist():
        if step == 0:
            found.append(found[-1])
        else:
            found.append(Direction.RISING if step > 0 else Direction.FALLING)
    return found
