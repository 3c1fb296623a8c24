"""Where an effect sits: places are added while they explain trials that were not fitted.

An effect of typical size in one place changes the readings by the columns of a `LinearEffect`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import chain, combinations, product

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_gap.diagnosis.evidence import (
    Reduced,
    held_out_squares,
    products,
    solve,
    weight,
)
from cablesense_gap.diagnosis.problem import (
    Explanation,
    Problem,
    excess,
    from_scaled,
    is_logarithmic,
    prior_precision,
    to_scaled,
)
from cablesense_gap.simulator import Assignment, Candidate, Term
from cablesense_sim.effects.effect import WHOLE_ARM, Parameter

WORTH = 1.12
"""A further place must make the cost of what is left smaller by this factor."""

MOST_IN_TWOS = 40
"""With so many places or fewer left, two at a time are tried where one is not worth it."""

_SHAPE_STEP = 0.3
_TRIED = 4
_NEARLY = 1.5


@dataclass(frozen=True)
class LinearEffect:
    """One effect in one place, linear in its scaled numbers.

    Attributes:
        place: where.
        terms: its numbers.
        start: scaled values of the terms to begin a search with.
        columns: (K, R, C) what each scaled number changes.
        precision: (K,) of the priors.
        probed: (K,) names of the parameters that the columns belong to.
    """

    place: str
    terms: tuple[Term, ...]
    start: Array
    columns: Array
    precision: Array
    probed: tuple[str, ...]


def linear_effects(
    problem: Problem, candidate: Candidate, about: Explanation | None = None
) -> list[tuple[LinearEffect, ...]]:
    """For each combination of starting shapes, the candidate in every place.

    Linear about the nominal mechanism, or about an explanation without what depends on history in
    it; places that this has already, and those that the mechanism cannot be simulated with, are
    left out. A history-dependent effect is simulated in all places and shapes side by side, which
    is worth while only for such a one.
    """
    everything = {} if about is None else dict(about.values)
    slow = {c.effect for c in problem.simulator.candidates if c.history_dependent}
    known = {term: value for term, value in everything.items() if term.effect not in slow}
    base = problem.nominal if about is None else about.without_tolerances
    if len(known) < len(everything):
        base = problem.simulator.predict([known])[0]
    taken = {term.place for term in everything if term.effect == candidate.effect}
    offered = [place for place in candidate.places if place not in taken]
    first_values = [
        p.starts or (p.typical if p.role == "size" else p.default,) for p in candidate.parameters
    ]
    combined = [
        dict(zip((p.name for p in candidate.parameters), starts, strict=True))
        for starts in product(*first_values)
    ]
    absent = {p.name: 0.0 for p in candidate.parameters if p.role == "size"}

    def variant(place: str, begun: dict[str, float], probe: dict[str, float]) -> Assignment:
        among = offered if candidate.history_dependent else (place,)
        return known | {
            Term(candidate.effect, at, name): value
            for at in among
            for name, value in (begun | absent | (probe if at == place else {})).items()
        }

    probed = [(begun, _probes(candidate, begun)) for begun in combined]
    batches = [
        [variant(place, begun, probe) for _, probe in probes]
        for begun, probes in probed
        for place in offered
    ]
    if candidate.history_dependent:
        batches = [list(chain(*batches))]
    changes = (c for b in batches for c in problem.simulator.predict(b) - base)
    found = []
    for begun, probes in probed:
        parameters = [parameter for parameter, _ in probes]
        effects = [
            _linear_effect(
                candidate, at, begun, parameters, np.array([next(changes) for _ in probes])
            )
            for at in offered
        ]
        found.append(tuple(e for e in effects if np.isfinite(e.columns).all()))
    return found


def _probes(
    candidate: Candidate, begun: dict[str, float]
) -> list[tuple[Parameter, dict[str, float]]]:
    """Parameters that screening takes as linear, each with values that show what it changes.

    Those are the sizes, and such shapes as may be zero. A shape has an effect only where there is
    a size: it is probed beside the first one.
    """
    first = next(p for p in candidate.parameters if p.role == "size")
    found = []
    for parameter in candidate.parameters:
        if parameter.role == "size":
            found.append((parameter, {parameter.name: begun[parameter.name]}))
        elif not is_logarithmic(parameter):
            moved = to_scaled(parameter, begun[parameter.name]) + _step(parameter, begun)
            there = {first.name: begun[first.name], parameter.name: from_scaled(parameter, moved)}
            found.append((parameter, there))
    return found


def _step(parameter: Parameter, begun: dict[str, float]) -> float:
    ahead = to_scaled(parameter, begun[parameter.name]) + _SHAPE_STEP
    return _SHAPE_STEP if ahead * parameter.typical <= parameter.high else -_SHAPE_STEP


def _linear_effect(
    candidate: Candidate,
    place: str,
    begun: dict[str, float],
    probed: Sequence[Parameter],
    changes: Array,
) -> LinearEffect:
    """What each number changes, in the mean up to the size that is probed."""
    first = next(k for k, p in enumerate(probed) if p.role == "size")
    size = to_scaled(probed[first], begun[probed[first].name])
    columns = [
        change / to_scaled(p, begun[p.name])
        if p.role == "size"
        else (change - changes[first]) / (size * _step(p, begun))
        for p, change in zip(probed, changes, strict=True)
    ]
    start = [
        0.0 if p.role == "size" else to_scaled(p, begun[p.name]) for p in candidate.parameters
    ]
    return LinearEffect(
        place,
        candidate.terms(place),
        np.array(start),
        np.array(columns),
        np.array([prior_precision(p) for p in probed]),
        tuple(p.name for p in probed),
    )


@dataclass(frozen=True)
class Placed:
    """An effect in the places that explain most.

    Attributes:
        chosen: the effect in each place, in the order in which they were found.
        coefficients: (K,) of their columns, scaled.
        mean_square: of all that is left on held-out trials.
        tolerance_chi2: sum of the squares of the tolerances beside them, in standard deviations.
    """

    chosen: tuple[LinearEffect, ...]
    coefficients: Array
    mean_square: float
    tolerance_chi2: float


def place(
    problem: Problem, residual: Array, beside: Array, offered: Sequence[LinearEffect]
) -> list[Placed]:
    """The best places for one effect, at least one, if any is offered.

    Where that is a single place, and nothing is beside it, the second best single place follows if
    it explains nearly as much: a search from there may yet end better.

    `residual` (R, C) is what is to be explained, `beside` (B, R, C) are scaled columns of effects
    already found, which are fitted along with the tolerances.
    """
    if not offered:
        return []
    search = Placing(problem, residual, beside, offered)
    whole = [k for k, effect in enumerate(offered) if effect.place == WHOLE_ARM]
    single = [k for k, effect in enumerate(offered) if effect.place != WHOLE_ARM]
    paths = [search.grow(among) for among in (whole, single) if among]
    best = min(paths, key=lambda path: path[1])
    if len(paths) == 2 and paths[0][0] and paths[0][1] < WORTH * paths[1][1]:
        best = paths[0]
    found = [best]
    if len(best[0]) == 1 and not len(beside):
        others = [search.grow([k], most=1) for k in range(len(offered)) if k != best[0][0]]
        found += sorted(others, key=lambda path: path[1])[:1]
    return [search.placed(chosen) for chosen, left in found if left <= _NEARLY * best[1]]


class Placing:
    """Linear effects among which places are chosen; tolerances and others are fitted along.

    Attributes:
        data: products of all columns with the residual, by fold; the `base` ones that are fitted
            along come first.
        precision: of the priors of all columns.
        owned: columns of each effect.
    """

    def __init__(
        self, problem: Problem, residual: Array, beside: Array, offered: Sequence[LinearEffect]
    ) -> None:
        """As for `place`."""
        columns = [problem.tolerance_columns, beside, *(e.columns for e in offered)]
        self.base = len(problem.tolerance_columns) + len(beside)
        ends = self.base + np.cumsum([len(e.columns) for e in offered], dtype=np.int64)
        self.owned = [np.arange(n - len(e.columns), n) for n, e in zip(ends, offered, strict=True)]
        fold_of_row = problem.fold[problem.trial]
        self.data = products(np.concatenate(columns), residual, fold_of_row, problem.used)
        self.precision = np.concatenate([np.ones(self.base), *(e.precision for e in offered)])
        self._problem, self._offered = problem, offered
        self._folds = np.arange(len(self.data.count))

    def grow(self, among: Sequence[int], most: int = 99) -> tuple[list[int], float]:
        """Places added one by one, and the cost of what is left.

        Where one more is not worth it two more may be: of two cables that pull against each
        other, either alone may explain nothing.
        """
        chosen: list[int] = []
        left = self.left(chosen)
        while len(chosen) < min(len(among), most):
            rest, worth = [k for k in among if k not in chosen], WORTH
            tried, now = self.best(chosen, [[k] for k in rest])
            if chosen and now * WORTH > left and len(chosen) + 2 <= most:
                twos = combinations(rest, 2) if len(rest) <= MOST_IN_TWOS else ()
                tried, now = self.best(chosen, [list(two) for two in twos])
                worth = WORTH**2
            if chosen and now * worth > left:
                break
            chosen, left = tried, now
        return chosen, left

    def best(
        self,
        chosen: Sequence[int],
        more: Sequence[Sequence[int]],
        worth: Callable[[Sequence[int]], float] = lambda _: 1.0,
    ) -> tuple[list[int], float]:
        """The best of several options to add to what is chosen, and the cost of what it leaves.

        Costs are multiplied by what an option must be worth. All are ranked at the weight of what
        is left without them, and few judged each at its own.
        """
        if not more:
            return [], np.inf
        weight_ = weight(self._fitted(chosen)[1], self._problem.floor)
        reduced = self.reduced(weight_)
        options = [[*chosen, *option] for option in more]
        sets = [np.concatenate([self.owned[k] for k in o]) - self.base for o in options]
        left, counts = np.empty(len(sets)), np.array([len(columns) for columns in sets])
        for count in np.unique(counts):
            at = np.flatnonzero(counts == count)
            left[at] = reduced.mean_squares(np.array([sets[k] for k in at]))
        factors = np.array([worth(option) for option in more])
        forecast = factors * [excess(each, self._problem.floor) for each in left]
        tried = [(self.left(options[k]) * factors[k], k) for k in np.argsort(forecast)[:_TRIED]]
        now, at_best = min(tried)
        return options[at_best], float(now)

    def reduced(self, weight_: float) -> Reduced:
        """All effects' columns with the others eliminated."""
        return Reduced(self.data, self.base, self.precision, weight_, self._folds)

    def placed(self, chosen: Sequence[int]) -> Placed:
        """The chosen effects with their coefficients and what they leave."""
        found, mean_square, chi2 = self._fitted(chosen)
        effects = tuple(self._offered[k] for k in chosen)
        return Placed(effects, found[self.base :], mean_square, chi2)

    def left(self, chosen: Sequence[int]) -> float:
        """The cost of what the chosen effects leave."""
        return self._problem.cost(*self._fitted(chosen)[1:])

    def _fitted(self, chosen: Sequence[int]) -> tuple[Array, float, float]:
        """Coefficients, the mean square left on held-out trials, and that of tolerances."""
        at, problem = self._columns(chosen), self._problem
        part, precision, none = self.data.columns(at), self.precision[at], np.zeros(len(at))
        count, weight_ = part.count.sum(), weight(self.data.mean_square, problem.floor)
        squares = held_out_squares(part, precision, none, weight_, self._folds).sum()
        weight_ = weight(float(squares / count), problem.floor)
        found = solve(part.gram.sum(0), part.moment.sum(0), precision, none, weight_)
        squares = held_out_squares(part, precision, none, weight_, self._folds).sum()
        chi2 = float((found[: len(problem.tolerance_terms)] ** 2).sum())
        return found, float(squares / count), chi2

    def _columns(self, chosen: Sequence[int]) -> NDArray[np.int64]:
        return np.concatenate([np.arange(self.base), *(self.owned[k] for k in chosen)])
