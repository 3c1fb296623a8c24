"""First looks: where effects would sit and how large they would be, linear about the nominal.

A first look at two effects at once: where both sit, linear about the nominal mechanism.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import NamedTuple

import numpy as np

from cablesense_base.arrays import Array
from cablesense_gap.diagnosis.evidence import Indices, Reduced, products, weight
from cablesense_gap.diagnosis.places import MOST_IN_TWOS, WORTH, Block, Placed, Placing, place
from cablesense_gap.diagnosis.problem import Course, Hypothesis, excess
from cablesense_gap.simulator import Candidate
from cablesense_sim.effects.effect import WHOLE_ARM

_ROUNDS = 2
_MOST_PLACES = 12

Effects = tuple[str, str]


@dataclass(frozen=True)
class _Side:
    """The places that one effect may take together: the whole arm, or any of the others."""

    effect: str
    blocks: tuple[int, ...]
    whole: bool


def pair_looks(
    course: Course,
    residual: Array,
    offered: Mapping[str, Sequence[Sequence[Block]]],
    mean_square: float,
) -> dict[Effects, Placed]:
    """The best places of every two of the offered effects.

    `residual` (R, C) is what is to be explained; `offered` holds each effect's blocks, once for
    each combination of starting shapes; `mean_square` is what pairs are expected to leave, at
    most: it tells what a reading weighs before one is known.
    """
    blocks = [block for every in offered.values() for some in every for block in some]
    sides = list(_sides(offered))
    if not blocks:
        return {}
    base = len(course.tolerance_columns)
    columns = np.concatenate([course.tolerance_columns, *(b.columns for b in blocks)])
    data = products(columns, residual, course.trial, course.used)
    precision = np.concatenate([np.ones(base), *(b.precision for b in blocks)])
    ends = np.cumsum([len(b.columns) for b in blocks])
    owned = [np.arange(e - len(b.columns), e) for e, b in zip(ends, blocks, strict=True)]
    chosen: dict[Effects, list[int]] = {}
    for _ in range(_ROUNDS):
        reduced = Reduced(data, base, precision, weight(mean_square, course.floor), course.fold)
        chosen, mean_square = _best_of_each(_Pairing(reduced, owned, course), sides)
    placing = Placing(course, data, precision, np.arange(base), [base + own for own in owned])
    return {names: placing.placed(at, blocks) for names, at in chosen.items()}


def _best_of_each(
    pairing: _Pairing, sides: Sequence[_Side]
) -> tuple[dict[Effects, list[int]], float]:
    """Blocks for every two effects, and the least mean square; the whole arm where it may be."""
    best: dict[Effects, tuple[float, _Grown]] = {}
    for one, other in combinations(sides, 2):
        if one.effect == other.effect:
            continue
        names = one.effect, other.effect
        grown = pairing.grow(one, other)
        judged = grown.cost * WORTH ** -(one.whole + other.whole)
        if names not in best or judged < best[names][0]:
            best[names] = judged, grown
    least = min((grown.mean_square for _, grown in best.values()), default=0.0)
    return {names: grown.chosen for names, (_, grown) in best.items()}, least


def _sides(offered: Mapping[str, Sequence[Sequence[Block]]]) -> list[_Side]:
    found, begin = [], 0
    for effect, every in offered.items():
        for some in every:
            at = range(begin, begin + len(some))
            for whole in (True, False):
                mine = tuple(
                    k for k, b in zip(at, some, strict=True) if (b.place == WHOLE_ARM) == whole
                )
                if mine:
                    found.append(_Side(effect, mine, whole))
            begin += len(some)
    return found


class _Grown(NamedTuple):
    chosen: list[int]
    cost: float
    mean_square: float


class _Pairing:
    def __init__(self, reduced: Reduced, owned: Sequence[Indices], course: Course) -> None:
        self._reduced, self._owned, self._course = reduced, owned, course

    def grow(self, one: _Side, other: _Side) -> _Grown:
        """The best place of each, and further places of either, as long as they are worth it."""
        grown = self._best([list(both) for both in product(one.blocks, other.blocks)])
        while len(grown.chosen) < _MOST_PLACES:
            tried, worth = self._one_more(grown, one, other), WORTH
            if tried and tried.cost * WORTH > grown.cost:
                tried, worth = self._two_more(grown, one, other), WORTH**2
            if tried is None or tried.cost * worth > grown.cost:
                break
            grown = tried
        return grown

    def _one_more(self, grown: _Grown, one: _Side, other: _Side) -> _Grown | None:
        further = [
            self._best([[*grown.chosen, k] for k in side.blocks if k not in grown.chosen])
            for side in (one, other)
            if set(side.blocks) - set(grown.chosen)
        ]
        return min(further, key=lambda option: option.cost, default=None)

    def _two_more(self, grown: _Grown, one: _Side, other: _Side) -> _Grown | None:
        rests = [[k for k in side.blocks if k not in grown.chosen] for side in (one, other)]
        further = [
            self._best([[*grown.chosen, *two] for two in combinations(rest, 2)])
            for rest in rests
            if 2 <= len(rest) <= MOST_IN_TWOS
        ]
        return min(further, key=lambda option: option.cost, default=None)

    def _best(self, options: list[list[int]]) -> _Grown:
        sets = np.array([np.concatenate([self._owned[k] for k in chosen]) for chosen in options])
        left, strains = self._reduced.mean_squares(sets), self._reduced.strains(sets)
        cost = [self._course.cost(*both) for both in zip(left, strains, strict=True)]
        at = int(np.argmin(cost))
        return _Grown(options[at], cost[at], float(left[at]))


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
