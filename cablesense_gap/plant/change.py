"""A change of an arm: one thing that is wrong, in one physical form, at a place, of a size.

What it does to the arm is data: which fields of which part it sets, and how its size enters. The
functions that draw changes are registered by their names, each with the bounds of its size.
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

UNKNOWN = "unknown"

Apply = Callable[[RealArm, float], RealArm]
"""Gives the arm with a change of a size."""


@dataclass(frozen=True)
class Change:
    """What is wrong, but for how much.

    Attributes:
        apply: gives the arm that has it, by size.
        form: what it physically is; by default the name of the function that draws it.
        where: places (`cable_3`, `segment_2`, `joint_1`); none for the whole arm.
        details: what else was drawn, for the answers.
        effect: its name in verdicts, `unknown` outside the list.
        unit: of its size.
        least: smallest size that is worth drawing.
        most: largest size that an arm would still be used with.
    """

    apply: Apply
    form: str = ""
    where: tuple[str, ...] = ()
    details: Mapping[str, float] = field(default_factory=dict)
    effect: str = ""
    unit: str = ""
    least: float = 0.0
    most: float = 0.0


Draw = Callable[[np.random.Generator, Nominal], Change]
"""Draws the form and the place of a change; its size comes later."""


@dataclass(frozen=True)
class Draws:
    """Draws by name; the order is part of what a seed makes.

    Attributes:
        effect: what verdicts call all of them; by default the name of each.
    """

    effect: str = ""
    by_name: dict[str, Draw] = field(default_factory=dict)

    def of_size(self, unit: str, least: float = 0.0, most: float = 0.0) -> Callable[[Draw], Draw]:
        """Register a function whose changes have sizes within bounds, if it gives no others."""

        def register(draw: Draw) -> Draw:
            name = draw.__name__

            def complete(rng: np.random.Generator, nominal: Nominal) -> Change:
                drawn = draw(rng, nominal)
                return replace(
                    drawn,
                    form=drawn.form or name,
                    effect=self.effect or name,
                    unit=drawn.unit or unit,
                    least=drawn.least or least,
                    most=drawn.most or most,
                )

            self.by_name[name] = complete
            return draw

        return register


def sets(part: str, **fields: Any) -> Apply:
    """Sets fields of a part of the arm (`body` …), each to a value, or as a tuple has it.

    A tuple is a law, as `scaled`, and what it takes beside the field's old value and the size.
    """
    return partial(_with_fields, part=part, fields=fields)


def _with_fields(arm: RealArm, size: float, part: str, fields: Mapping[str, Any]) -> RealArm:
    whole = getattr(arm, part)
    new = {
        name: value[0](getattr(whole, name), size, *value[1:]) if type(value) is tuple else value
        for name, value in fields.items()
    }
    return replace(arm, **{part: replace(whole, **new)})


def scaled(_old: Any, size: float, share: Any) -> Any:
    """A share of the size."""
    return size * share


def added(old: Any, size: float, share: Any) -> Any:
    """A share of the size added."""
    return old + size * share


def grown(old: Any, size: float, share: Any) -> Any:
    """The old value times 1 and a share of the size."""
    return old * (1.0 + size * share)


def sized(old: Any, size: float, value: Any, name: str) -> Any:
    """A value, or a tuple of one where there was a tuple, with one field times the size."""
    new = replace(value, **{name: size * getattr(value, name)})
    return (new,) if isinstance(old, tuple) else new


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
