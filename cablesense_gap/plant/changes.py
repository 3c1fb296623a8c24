"""A change: one thing that is wrong with an arm, in one physical form, at a place, of a size.

What a change does to the arm is data: which fields of which part it sets, and how its size enters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from cablesense_base.arrays import Array
from cablesense_gap.plant.arm import RealArm
from cablesense_gap.plant.body import Nominal

Draw = Callable[[np.random.Generator, Nominal], "Change"]
"""Draws the form and the place of a change; its size comes later."""

Apply = Callable[[RealArm, float], RealArm]
"""Gives the arm with a change of a size; cases go to other processes, so it can be pickled."""

UNKNOWN = "unknown"


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
    apply: Apply
    where: tuple[str, ...] = ()
    details: Mapping[str, float | str] = field(default_factory=dict)


def sets(part: str, **fields: Any) -> Apply:
    """Sets fields of a part of the arm (`body` …) to values, or by what `scaled` etc. give."""
    return partial(_with_fields, part=part, fields=fields)


def scaled(share: Any) -> Callable[[Any, float], Any]:
    """Sets a field to its share of the size."""
    return partial(_scaled, share=share)


def added(share: Any) -> Callable[[Any, float], Any]:
    """Adds a share of the size to a field."""
    return partial(_added, share=share)


def grown(share: Any) -> Callable[[Any, float], Any]:
    """Multiplies a field by 1 and a share of the size."""
    return partial(_grown, share=share)


def sized(value: Any, name: str) -> Callable[[Any, float], Any]:
    """Sets a field to a value, or a tuple of one, after multiplying a field of it by the size."""
    return partial(_sized, value=value, name=name)


def some(rng: np.random.Generator, count: int, least: int, most: int) -> list[int]:
    """Between `least` and `most` of the positions below `count`, ascending."""
    number = int(rng.integers(least, min(most, count) + 1))
    return sorted(int(i) for i in rng.choice(count, number, replace=False))


def places(kind: str, positions: Sequence[int], count: int) -> tuple[str, ...]:
    """Names of positions counted from 0; none where they are all."""
    return () if len(positions) == count else tuple(f"{kind}_{i + 1}" for i in positions)


def weights(
    rng: np.random.Generator, positions: list[int], count: int, signed: bool = False
) -> Array:
    """(count,) of 0, and of numbers between 0.5 and 1 at the positions; one is 1 or -1."""
    result = np.zeros(count)
    drawn = rng.uniform(0.5, 1.0, len(positions))
    drawn /= drawn.max()
    result[positions] = drawn * rng.choice([-1.0, 1.0], len(drawn)) if signed else drawn
    return result


def marked(positions: Any, count: int, value: float = 1.0) -> Array:
    """(count,) of 0, and of a value at the positions."""
    result = np.zeros(count)
    result[positions] = value
    return result


def _with_fields(arm: RealArm, size: float, part: str, fields: Mapping[str, Any]) -> RealArm:
    whole = getattr(arm, part)
    new = {
        name: value(getattr(whole, name), size) if callable(value) else value
        for name, value in fields.items()
    }
    return replace(arm, **{part: replace(whole, **new)})


def _scaled(old: Any, size: float, share: Any) -> Any:
    del old
    return size * share


def _added(old: Any, size: float, share: Any) -> Any:
    return old + size * share


def _grown(old: Any, size: float, share: Any) -> Any:
    return old * (1.0 + size * share)


def _sized(old: Any, size: float, value: Any, name: str) -> Any:
    new = replace(value, **{name: size * getattr(value, name)})
    return (new,) if isinstance(old, tuple) else new
