"""A first look at two effects at once: where both sit, linear about the nominal mechanism."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from typing import NamedTuple

import numpy as np

from cablesense_gap.diagnosis.blocks import Block
from cablesense_gap.diagnosis.course import Course
from cablesense_gap.diagnosis.evidence import Indices, products, weight
from cablesense_gap.diagnosis.placing import MOST_IN_TWOS, WORTH, Placed, Placing
from cablesense_gap.diagnosis.reduced import Reduced
from cablesense_gap.simulator import Array
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
