"""A change: one thing that is wrong with an arm, in one physical form, at a place, of a size."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from cablesense_gap.plant.arm import RealArm
from cablesense_gap.plant.body import Nominal

Draw = Callable[[np.random.Generator, Nominal], "Change"]
"""Draws the form and the place of a change; its size comes later."""


@dataclass(frozen=True)
class Change:
    """What is wrong, but for how much.

    Attributes:
        effect: its name in verdicts, `unknown` outside the list.
        form: what it physically is.
        unit: of its size.
        least: smallest size that is worth drawing.
        most: largest size that an arm would still be used with.
        apply: gives the arm that has it, by size.
        where: places (`cable_3`, `segment_2`, `joint_1`); none for the whole arm.
        details: what else was drawn, for the answers.
    """

    effect: str
    form: str
    unit: str
    least: float
    most: float
    apply: Callable[[RealArm, float], RealArm]
    where: tuple[str, ...] = ()
    details: Mapping[str, float | str] = field(default_factory=dict)


def some(rng: np.random.Generator, count: int, least: int, most: int) -> list[int]:
    """Between `least` and `most` of the positions below `count`, ascending."""
    number = int(rng.integers(least, min(most, count) + 1))
    return sorted(int(i) for i in rng.choice(count, number, replace=False))


def places(kind: str, positions: list[int], count: int) -> tuple[str, ...]:
    """Names of positions counted from 0; none where they are all."""
    return () if len(positions) == count else tuple(f"{kind}_{i + 1}" for i in positions)


def weights(
    rng: np.random.Generator, positions: list[int], count: int, signed: bool = False
) -> np.ndarray:
    """(count,) of 0, and of numbers between 0.5 and 1 at the positions; one is 1 or -1."""
    result = np.zeros(count)
    drawn = rng.uniform(0.5, 1.0, len(positions))
    drawn /= drawn.max()
    result[positions] = drawn * rng.choice([-1.0, 1.0], len(drawn)) if signed else drawn
    return result
