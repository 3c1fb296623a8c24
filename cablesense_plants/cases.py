"""The common part of both plants' cases: hidden changes, the order of names, the answers' file."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import astuple, dataclass, field, fields
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from cablesense_base import CableSenseError
from cablesense_base.files import written_whole

NONE, UNKNOWN = "none", "unknown"
"""Answers if nothing is hidden, and if verdicts have no name for the change."""

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


def in_turn(rng: np.random.Generator, names: Sequence[str]) -> Iterator[str]:
    """Names without end, none twice before all have come once."""
    while True:
        yield from (names[i] for i in rng.permutation(len(names)))


def different(names: Iterator[str], count: int) -> list[str]:
    """The next `count` names that differ from each other."""
    found: list[str] = []
    while len(found) < count:
        name = next(names)
        found += [name] if name not in found else []
    return found


def write_answers(path: Path, answers: Sequence[Any], decimals: int | None = None) -> None:
    """Write dataclasses of one kind as CSV, floats with all their digits or some decimals.

    Raises:
        PlantError: the place cannot be written to.
    """

    def cell(value: Any) -> Any:
        rounded = isinstance(value, float) and decimals is not None
        return f"{value:.{decimals}f}" if rounded else value

    with plant_file(path) as beside, beside.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(each.name for each in fields(answers[0]))
        table.writerows([cell(value) for value in astuple(answer)] for answer in answers)


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
