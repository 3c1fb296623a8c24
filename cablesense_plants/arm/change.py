"""A change of an arm: one thing that is wrong, in one physical form, at a place, of a size.

What it does to the arm is data: which fields of which part it sets, and how its size enters. The
functions that draw changes are registered by their names, each with the bounds of its size.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from cablesense_base import Array
from cablesense_plants.arm.arm import RealArm
from cablesense_plants.arm.body import Nominal
from cablesense_plants.cases import HiddenChange

Apply = Callable[[RealArm, float], RealArm]
"""Gives the arm with a change of a size."""


ArmChange = HiddenChange[RealArm]


@dataclass(frozen=True)
class ArmDraw:
    """Random draws of changes of an arm as drawn; its M cables count from 0."""

    rng: np.random.Generator
    nominal: Nominal

    def uniform(self, low: float, high: float) -> float:
        """A number between two, all alike."""
        return float(self.rng.uniform(low, high))

    def log_uniform(self, low: float, high: float) -> float:
        """A number between two, alike in its logarithm."""
        return float(np.exp(self.rng.uniform(*np.log([low, high]))))

    def chance(self, share: float) -> bool:
        """True in this share of draws."""
        return bool(self.rng.random() < share)

    def sign(self) -> float:
        """1 or -1."""
        return float(self.rng.choice([-1.0, 1.0]))

    def one_of(self, texts: Iterable[str]) -> str:
        """One of some texts."""
        return str(self.rng.choice(list(texts)))

    def segment(self) -> int:
        """A segment or its joint, from 0."""
        return int(self.rng.integers(self.nominal.segment_count))

    def some(self, count: int, least: int, most: int) -> list[int]:
        """Between `least` and `most` of the positions below `count`, ascending."""
        number = int(self.rng.integers(least, min(most, count) + 1))
        return sorted(int(i) for i in self.rng.choice(count, number, replace=False))

    def cables(self, least: int, most: int) -> list[int]:
        """Between `least` and `most` of the cables, ascending."""
        return self.some(self.nominal.cable_count, least, most)

    def weights(self, chosen: list[int], signed: bool = False) -> Array:
        """(M,) of 0, and of numbers between 0.5 and 1 at the chosen; one is 1 or -1."""
        weights = np.zeros(self.nominal.cable_count)
        drawn = self.rng.uniform(0.5, 1.0, len(chosen))
        drawn /= drawn.max()
        weights[chosen] = drawn * self.rng.choice([-1.0, 1.0], len(drawn)) if signed else drawn
        return weights


_Drawing = Callable[[ArmDraw], ArmChange]


@dataclass(frozen=True)
class Draws:
    """Functions that draw changes, by name; the order is part of what a seed makes.

    Attributes:
        effect: what verdicts call all their changes; by default the name of each.
    """

    effect: str = ""
    by_name: dict[str, Callable[[np.random.Generator, Nominal], ArmChange]] = field(
        default_factory=dict
    )

    def of_size(self, unit: str, least: float = 0.0, most: float = 0.0) -> Callable[..., Any]:
        """Register a function whose changes have sizes within bounds, if it gives no others."""

        def register(draw_change: _Drawing) -> _Drawing:
            name = draw_change.__name__

            def complete(rng: np.random.Generator, nominal: Nominal) -> ArmChange:
                drawn = draw_change(ArmDraw(rng, nominal))
                return replace(
                    drawn,
                    form=drawn.form or name,
                    effect=self.effect or name,
                    unit=drawn.unit or unit,
                    least=drawn.least or least,
                    most=drawn.most or most,
                )

            self.by_name[name] = complete
            return draw_change

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


def places(kind: str, marks: Array) -> tuple[str, ...]:
    """Names of the places, counted from 0, where marks are not 0; none where they are all."""
    return () if marks.all() else tuple(f"{kind}_{i + 1}" for i in np.flatnonzero(marks))


def marked(positions: Any, count: int, value: float = 1.0) -> Array:
    """(count,) of 0, and of a value at the positions."""
    marks = np.zeros(count)
    marks[positions] = value
    return marks
