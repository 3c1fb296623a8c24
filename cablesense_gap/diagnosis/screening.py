"""Screening: where one effect or two would sit and how large they would be, linearly.

The problem is linear about the nominal mechanism here, so that every effect, and every two of
them, can be tried in all places; the simulator itself then fits what is promising.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import NamedTuple

import numpy as np

from cablesense_gap.diagnosis.evidence import Indices, weight
from cablesense_gap.diagnosis.places import (
    MOST_IN_TWOS,
    WORTH,
    LinearEffect,
    Placed,
    Placing,
    place,
)
from cablesense_gap.diagnosis.problem import Explanation, Problem, excess
from cablesense_gap.simulator import parameters_of
from cablesense_sim.effects.effect import WHOLE_ARM

Offered = Mapping[str, Sequence[tuple[LinearEffect, ...]]]
"""Effects by name, each linear in every place, for every combination of starting shapes."""

_PROMISING = 3.0
_HOPELESS = 2.5
_ROUNDS = 2
_LEAST_CHANNELS = 12
"""Places of a pair are added up to the number of channels, or this many."""


@dataclass(frozen=True)
class Screened:
    """One effect or two in their best places, beside another that was fitted before or none.

    A fit is not worth while if its starts leave a mean square of more than `most_left`.
    """

    placed: Placed
    beside: Explanation | None = None
    most_left: float = np.inf

    @property
    def effects(self) -> tuple[str, ...]:
        """All names, in alphabetical order."""
        known = () if self.beside is None else self.beside.effects
        return tuple(sorted({*known, *(e.terms[0].effect for e in self.placed.chosen)}))


def screen_singles(
    problem: Problem, offered: Offered, beside: Explanation | None = None
) -> list[Screened]:
    """For each effect its best places with the best of its starting shapes, perhaps two of them.

    Beside other effects, which are fitted along, only one. The most promising come first.
    """
    residual = problem.readings - problem.nominal
    columns = np.empty((0, *residual.shape))
    if beside is not None:
        residual, columns = problem.readings - beside.without_tolerances, beside.columns
    found = []
    for effect, shapes in offered.items():
        if beside is not None and effect in beside.effects:
            continue
        placed = [p for every in shapes if (p := place(problem, residual, columns, every))]
        best = min(placed, key=lambda p: p[0].mean_square, default=[])
        found += [Screened(p, beside) for p in (best if beside is None else best[:1])]
    return by_forecast(problem, found)


def screen_pairs(
    problem: Problem, offered: Offered, mean_square: float, beside: Explanation | None = None
) -> list[Screened]:
    """For every two effects their best places, the most promising first.

    `mean_square` is what the best single one leaves: it gives the weight of a reading before the
    best pair is known. What is `beside` them is fitted along.
    """
    everything = [effect for shapes in offered.values() for every in shapes for effect in every]
    if not everything:
        return []
    residual = problem.readings - problem.nominal
    columns = np.empty((0, *residual.shape))
    if beside is not None:
        residual, columns = problem.readings - beside.without_tolerances, beside.columns
    placing = Placing(problem, residual, columns, everything)
    sides = list(_sides(offered))
    pairs: dict[tuple[str, str], list[int]] = {}
    for _ in range(_ROUNDS):
        weight_ = weight(mean_square, problem.floor)
        pairs, mean_square = _best_pairs(_Pairing(problem, placing, weight_), sides)
    screened = [Screened(placing.placed(chosen), beside) for chosen in pairs.values()]
    return by_forecast(problem, screened)


def by_forecast(problem: Problem, screened: Sequence[Screened]) -> list[Screened]:
    """Those first that leave little and need no help of tolerances."""
    return sorted(
        screened, key=lambda s: problem.cost(s.placed.mean_square, s.placed.tolerance_chi2)
    )


def promising(problem: Problem, screened: Sequence[Screened], best: float) -> Iterator[Screened]:
    """Those that a fit may yet bring to the front, where the best leaves an excess `best`."""
    for one in screened:
        if excess(one.placed.mean_square, problem.floor) <= _PROMISING * best:
            yield replace(one, most_left=(_HOPELESS * best) ** 2 + problem.floor**2)


def at_usual_size(problem: Problem, screened: Screened, most_left: float) -> Screened:
    """The same in its foremost place, with every size as large as is typical."""
    ranges, first = parameters_of(problem.simulator.candidates), screened.placed.chosen[0]
    size = {term.parameter: float(ranges[term].role == "size") for term in first.terms}
    sizes = np.array([size[name] for name in first.probed])
    placed = replace(screened.placed, chosen=(first,), coefficients=sizes)
    return replace(screened, placed=placed, most_left=most_left)


class _Side(NamedTuple):
    """The places that one effect may take together: the whole arm, or any of the others."""

    effect: str
    places: tuple[int, ...]
    whole: bool


class _Grown(NamedTuple):
    chosen: list[int]
    cost: float
    mean_square: float


def _sides(offered: Offered) -> Iterator[_Side]:
    begin = 0
    for effect, shapes in offered.items():
        for every in shapes:
            for whole in (True, False):
                own = tuple(
                    k for k, e in enumerate(every, begin) if (e.place == WHOLE_ARM) == whole
                )
                if own:
                    yield _Side(effect, own, whole)
            begin += len(every)


def _best_pairs(
    pairing: _Pairing, sides: Sequence[_Side]
) -> tuple[dict[tuple[str, str], list[int]], float]:
    """Places for every two effects, and the least mean square; the whole arm where it may be."""
    best: dict[tuple[str, str], tuple[float, _Grown]] = {}
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


class _Pairing:
    def __init__(self, problem: Problem, placing: Placing, weight_: float) -> None:
        self._problem = problem
        self._most_places = max(_LEAST_CHANNELS, problem.nominal.shape[1])
        self._owned: list[Indices] = [own - placing.base for own in placing.owned]
        self._reduced = placing.reduced(weight_)

    def grow(self, one: _Side, other: _Side) -> _Grown:
        """The best place of each, and further places of either, as long as they are worth it."""
        grown = self._best([list(both) for both in product(one.places, other.places)])
        while len(grown.chosen) < self._most_places:
            rests = [[k for k in s.places if k not in grown.chosen] for s in (one, other)]
            tried, worth = self._further(grown, rests, 1), WORTH
            if tried and tried.cost * WORTH > grown.cost:
                few = [rest for rest in rests if len(rest) <= MOST_IN_TWOS]
                tried, worth = self._further(grown, few, 2), WORTH**2
            if tried is None or tried.cost * worth > grown.cost:
                break
            grown = tried
        return grown

    def _further(self, grown: _Grown, rests: list[list[int]], count: int) -> _Grown | None:
        """The best with so many places more, all of one effect."""
        options = [
            self._best([[*grown.chosen, *more] for more in combinations(rest, count)])
            for rest in rests
            if len(rest) >= count
        ]
        return min(options, key=lambda option: option.cost, default=None)

    def _best(self, options: list[list[int]]) -> _Grown:
        sets = np.array([np.concatenate([self._owned[k] for k in chosen]) for chosen in options])
        count = len(self._problem.tolerance_terms)
        left, chi2 = self._reduced.mean_squares(sets), self._reduced.base_chi2(sets, count)
        cost = [self._problem.cost(*both) for both in zip(left, chi2, strict=True)]
        at = int(np.argmin(cost))
        return _Grown(options[at], cost[at], float(left[at]))
