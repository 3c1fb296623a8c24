"""First looks: where effects would sit and how large they would be, linear about the nominal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cablesense_gap.diagnosis.blocks import Block
from cablesense_gap.diagnosis.course import Course
from cablesense_gap.diagnosis.hypothesis import Hypothesis, excess
from cablesense_gap.diagnosis.pairing import pair_looks
from cablesense_gap.diagnosis.placing import Placed, place
from cablesense_gap.simulator import Candidate

Offered = Mapping[str, tuple[Candidate, Sequence[tuple[Block, ...]]]]
"""Candidates by name, each with its blocks for every combination of starting shapes."""

_PROMISING = 3.0
_HOPELESS = 2.5


@dataclass(frozen=True)
class Look:
    """A first look at one effect or two, beside another that was fitted before or none.

    A fit is not worth while if its starts leave a mean square of more than `most_left`.
    """

    placed: Placed
    beside: Hypothesis | None = None
    most_left: float = np.inf

    @property
    def effects(self) -> tuple[str, ...]:
        """All names, in alphabetical order."""
        known = () if self.beside is None else self.beside.effects
        return tuple(sorted({*known, *(b.terms[0].effect for b in self.placed.blocks)}))


def single_looks(course: Course, offered: Offered, beside: Hypothesis | None = None) -> list[Look]:
    """For each effect its best places with the best of its starting shapes, perhaps two of them.

    Beside another effect, which is fitted along, only one. The most promising come first.
    """
    residual = course.readings - course.nominal
    columns = np.empty((0, *residual.shape))
    if beside is not None:
        residual, columns = course.readings - beside.without_tolerances, beside.columns
    found = []
    for effect, (_, every) in offered.items():
        if beside is not None and effect in beside.effects:
            continue
        placed = [p for some in every if (p := place(course, residual, columns, some))]
        best = min(placed, key=lambda p: p[0].mean_square, default=[])
        found += [Look(p, beside) for p in (best if beside is None else best[:1])]
    return by_forecast(course, found)


def joint_looks(course: Course, offered: Offered, mean_square: float) -> list[Look]:
    """For every two effects their best places, the most promising first.

    `mean_square` is what the best single one leaves.
    """
    residual = course.readings - course.nominal
    blocks = {effect: every for effect, (_, every) in offered.items()}
    found = pair_looks(course, residual, blocks, mean_square)
    return by_forecast(course, [Look(placed) for placed in found.values()])


def by_forecast(course: Course, looks: Sequence[Look]) -> list[Look]:
    """Those first that leave little and need no help of tolerances."""
    return sorted(looks, key=lambda k: course.cost(k.placed.mean_square, k.placed.strain))


def promising(course: Course, looks: Sequence[Look], best: float) -> Iterator[Look]:
    """Those that a fit may yet bring to the front, where the best look leaves an excess `best`."""
    for look in looks:
        if excess(look.placed.mean_square, course.floor) <= _PROMISING * best:
            yield replace(look, most_left=(_HOPELESS * best) ** 2 + course.floor**2)
