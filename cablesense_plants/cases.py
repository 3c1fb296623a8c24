"""The common part of both plants' cases: hidden changes, the order of names, the answers' file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
import pandas as pd

from cablesense_base import CableSenseError
from cablesense_base.files import written_whole

NONE = "none"
UNKNOWN = "unknown"
"""Answers if nothing is hidden, and if verdicts have no name for the change."""

NO_FAULT: Any = np.float64(0.0)
"""No fault of any cable, joint, actuator or sensor: it takes the shape of whatever it meets."""

_Plant = TypeVar("_Plant")


class PlantError(CableSenseError):
    """A plant that cannot be built or finds no rest: names the fault, its place and the remedy."""


@dataclass(frozen=True)
class HiddenChange(Generic[_Plant]):
    """One thing that is wrong with a plant, in one physical form, except for its size.

    Attributes:
        apply: gives the plant with the change, by size.
        form: what it physically is.
        where: places (`cable_3`, a robot's joint or link); none for the whole plant.
        details: what else was drawn, for the answers.
        effect: its name in verdicts, `unknown` if they have none.
        unit: of its size.
        least: smallest size that is worth drawing.
        most: largest size at which a plant would still be used.
    """

    apply: Callable[[_Plant, float], _Plant]
    form: str = ""
    where: tuple[str, ...] = ()
    details: Mapping[str, float] = field(default_factory=dict)
    effect: str = ""
    unit: str = ""
    least: float = 0.0
    most: float = 0.0


class Draws(dict[str, Callable[[Any], Any]]):
    """Functions that draw changes, by name; the order is part of what a seed makes."""

    def __init__(self, effect: str = "") -> None:
        """`effect` is what verdicts call all the changes; by default the name of each."""
        super().__init__()
        self._effect = effect

    def of_size(self, unit: str, least: float = 0.0, most: float = 0.0) -> Callable[..., Any]:
        """Register a function whose changes have sizes within bounds, if it gives no others."""

        def register(draw_change: Any, name: str = "") -> Any:
            name = name or draw_change.__name__

            def complete(draw: Any) -> Any:
                drawn = draw_change(draw)
                return replace(
                    drawn,
                    form=drawn.form or name,
                    effect=self._effect or name,
                    unit=drawn.unit or unit,
                    least=drawn.least or least,
                    most=drawn.most or most,
                )

            self[name] = complete
            return draw_change

        return register


@dataclass(frozen=True)
class Draw:
    """Random draws for changes."""

    rng: np.random.Generator

    def uniform(self, low: float, high: float) -> float:
        """A number between two, all alike."""
        return float(self.rng.uniform(low, high))

    def chance(self, share: float) -> bool:
        """True in this share of draws."""
        return bool(self.rng.random() < share)

    def sign(self) -> float:
        """1 or -1."""
        return float(self.rng.choice([-1.0, 1.0]))

    def one_of(self, texts: Iterable[str]) -> str:
        """One of some texts."""
        return str(self.rng.choice(list(texts)))


def sets(part: str = "", /, **given: Any) -> Callable[[Any, float], Any]:
    """Sets fields of a plant, or of a part of it: to a value, or to one by `law(old, size)`."""

    def apply(plant: Any, size: float) -> Any:
        whole = getattr(plant, part) if part else plant
        new = {
            name: value(getattr(whole, name), size) if callable(value) else value
            for name, value in given.items()
        }
        changed = replace(whole, **new)
        return replace(plant, **{part: changed}) if part else changed

    return apply


Law = Callable[[Any, float], Any]


def scaled(share: Any) -> Law:
    """A share of the size, whatever was there."""
    return lambda _old, size: size * share


def added(share: Any) -> Law:
    """A share of the size added."""
    return lambda old, size: old + size * share


def at_index(index: int, law: Law) -> Law:
    """A law for one row of an array."""

    def apply(old: Any, size: float) -> Any:
        changed = old.copy()
        changed[index] = law(old[index], size)
        return changed

    return apply


def in_turn(rng: np.random.Generator, names: Sequence[str]) -> Iterator[str]:
    """Names without end, none twice before all have come once."""
    while True:
        yield from (names[i] for i in rng.permutation(len(names)))


def different(names: Iterator[str], count: int) -> list[str]:
    """The next `count` names that differ from each other."""
    chosen: list[str] = []
    while len(chosen) < count:
        name = next(names)
        chosen += [name] if name not in chosen else []
    return chosen


def write_answers(path: Path, answers: Sequence[Any], decimals: int | None = None) -> None:
    """Write dataclasses of one kind as CSV, floats with all their digits or some decimals.

    Raises:
        PlantError: the place cannot be written to.
    """
    form = None if decimals is None else f"%.{decimals}f"
    with plant_file(path) as beside:
        pd.DataFrame(answers).to_csv(beside, index=False, float_format=form)


def plant_file(path: Path) -> AbstractContextManager[Path]:
    """A file that appears whole or not at all; its folder is made.

    Raises:
        PlantError: the place cannot be written to.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise PlantError(f"{path}: cannot be written ({error.strerror or error})") from error
    return written_whole(path, PlantError)
