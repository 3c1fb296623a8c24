"""Effects as columns, and which of them explain a residual: chosen linear about one hypothesis.

A column is the change of the readings by one number of an effect in one place. The nuisance
parameters and the effects of the hypothesis are fitted along. A set of additions is grown location
by location; a location is an effect in one place. Several sets are grown at once, because the
first location that helps most is not always part of the best set.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations, product

import numpy as np

from cablesense_base import Array
from cablesense_gap.diagnosis.linear_fit import (
    Indices,
    Reduced,
    held_out_squares,
    products,
    solve,
    weight,
)
from cablesense_gap.diagnosis.problem import (
    Hypothesis,
    Problem,
    from_scaled,
    is_logarithmic,
    prior_precision,
    to_scaled,
)
from cablesense_gap.simulator import Assignment, Candidate, Term
from cablesense_sim.effects.effect import WHOLE_ARM, Parameter

_SHAPE_STEP = 0.3
"""Scaled change of a varied shape: well above the simulator's rounding, within its range."""
_MOST_CHANGE = 2.0
"""Of the residual, RMS: a size that changes readings by more is not the answer, and a column taken
there may be far from linear."""
_LEAST_CHANGE = 1e-12
"""RMS change below which a column counts as zero, in the unit of the channels: rounding."""


@dataclass(frozen=True, eq=False)
class LinearEffect:
    """One effect in one place, linear in its scaled numbers.

    Attributes:
        terms: its numbers.
        start: scaled values of the terms at which a fit starts.
        columns: (K, R, C) sensitivities to each varied number.
        precision: (K,) of the priors.
        varied: (K,) terms that the columns belong to.
    """

    place: str
    terms: tuple[Term, ...]
    start: Array
    columns: Array
    precision: Array
    varied: tuple[Term, ...]

    @property
    def effect(self) -> str:
        """Name of the effect."""
        return self.terms[0].effect


def linear_effects(
    problem: Problem, candidate: Candidate, about: Hypothesis | None = None
) -> list[LinearEffect]:
    """The candidate in every place, for each combination of starting shapes.

    It is linear about the nominal mechanism, or about a hypothesis without its history-dependent
    effects. Places that the hypothesis has already are left out, as are those with which the
    mechanism cannot be simulated. A history-dependent effect is simulated in all places and shapes
    in one call: its cost hardly depends on the number of variants.
    """
    everything = {} if about is None else dict(about.values)
    slow = {c.effect for c in problem.simulator.candidates if c.history_dependent}
    known = {term: value for term, value in everything.items() if term.effect not in slow}
    base = problem.nominal if about is None else about.without_nuisance
    if len(known) < len(everything):
        base = problem.predict([known])[0]
    taken = {term.place for term in everything if term.effect == candidate.effect}
    offered = [place for place in candidate.places if place not in taken]
    parameters = candidate.parameters
    first_values = [
        p.starts or (p.typical if p.role == "size" else p.default,) for p in parameters
    ]
    starts = [
        dict(zip((p.name for p in parameters), values, strict=True))
        for values in product(*first_values)
    ]
    absent = {p.name: 0.0 for p in parameters if p.role == "size"}
    # a number that is varied is a size, or a shape that may be zero
    varied = [p for p in parameters if p.role == "size" or not is_logarithmic(p)]

    def variant(place: str, start: dict[str, float], varied: Parameter) -> Assignment:
        among = offered if candidate.history_dependent else (place,)
        probe = _probe(candidate, start, varied)
        return known | {
            Term(candidate.effect, offered_place, name): value
            for offered_place in among
            for name, value in (start | absent | (probe if offered_place == place else {})).items()
        }

    batches = [[variant(place, start, p) for p in varied] for start in starts for place in offered]
    if candidate.history_dependent:
        batches = [list(chain(*batches))]
    changes = (c for b in batches for c in problem.predict(b) - base)
    sizes_alone = not candidate.history_dependent and len(absent) == len(parameters)
    residual_rms = _rms(problem, problem.readings - (base if about is None else about.prediction))

    def nearer(place: str, start: dict[str, float], p: Parameter, change: Array) -> Array:
        """The change by a number, in proportion to that by a size that suits the residual."""
        share = residual_rms / max(_rms(problem, change), _LEAST_CHANGE)
        smaller = {name: share * value for name, value in start.items()}
        if not sizes_alone or share * _MOST_CHANGE >= 1.0:
            return change
        again = problem.predict([variant(place, smaller, p)])[0] - base
        ratio = to_scaled(p, start[p.name]) / to_scaled(p, smaller[p.name])
        return ratio * again if np.isfinite(again).all() else change

    effects = []
    for start, place in product(starts, offered):
        changed = np.array([next(changes) for _ in varied])
        if np.isfinite(changed).all():
            number_changes = zip(varied, changed, strict=True)
            changed = np.array([nearer(place, start, p, change) for p, change in number_changes])
            effects.append(
                LinearEffect(
                    place=place,
                    terms=candidate.terms(place),
                    start=np.array(
                        [
                            0.0 if p.role == "size" else to_scaled(p, start[p.name])
                            for p in parameters
                        ]
                    ),
                    columns=_columns(varied, start, changed),
                    precision=np.array([prior_precision(p) for p in varied]),
                    varied=tuple(Term(candidate.effect, place, p.name) for p in varied),
                )
            )
    return effects


def _rms(problem: Problem, change: Array) -> float:
    return float(np.sqrt((change[problem.used] ** 2).mean()))


def _probe(
    candidate: Candidate, start: Mapping[str, float], varied: Parameter
) -> dict[str, float]:
    """Values that show the change by one number.

    A shape has an effect only with a size, so it is varied together with the first one.
    """
    if varied.role == "size":
        return {varied.name: start[varied.name]}
    first = next(p for p in candidate.parameters if p.role == "size")
    moved = to_scaled(varied, start[varied.name]) + _step(varied, start)
    return {first.name: start[first.name], varied.name: from_scaled(varied, moved)}


def _step(shape: Parameter, start: Mapping[str, float]) -> float:
    ahead = to_scaled(shape, start[shape.name]) + _SHAPE_STEP
    return _SHAPE_STEP if ahead * shape.typical <= shape.high else -_SHAPE_STEP


def _columns(varied: list[Parameter], start: Mapping[str, float], changes: Array) -> Array:
    """The mean change per unit of each number, up to the size that was simulated."""
    first = next(k for k, p in enumerate(varied) if p.role == "size")
    size = to_scaled(varied[first], start[varied[first].name])
    return np.array(
        [
            change / to_scaled(p, start[p.name])
            if p.role == "size"
            else (change - changes[first]) / (size * _step(p, start))
            for p, change in zip(varied, changes, strict=True)
        ]
    )


def own_columns(problem: Problem, fitted: Hypothesis) -> tuple[Hypothesis, list[LinearEffect]]:
    """A hypothesis as additions to the nominal mechanism, linear about it.

    Gives the base to add to and its locations; sizes that the fit held at zero are left out.
    """
    ranges = problem.parameters
    base = fitted.without_nuisance
    for column, (term, value) in zip(fitted.columns, fitted.values.items(), strict=True):
        if ranges[term].role == "size":
            base = base - to_scaled(ranges[term], value) * column
    locations = []
    for location in fitted.locations:
        column_of = {
            term: k
            for k, (term, value) in enumerate(fitted.values.items())
            if term[:2] == location and (value != 0.0 or ranges[term].low < 0.0)
        }
        if terms := tuple(column_of):
            precision = np.array([prior_precision(ranges[term]) for term in terms])
            columns = fitted.columns[list(column_of.values())]
            zero_start = np.zeros(len(column_of))
            locations.append(
                LinearEffect(location[1], terms, zero_start, columns, precision, terms)
            )
    nothing = replace(
        fitted, effects=(), values={}, columns=fitted.columns[:0], without_nuisance=base
    )
    return nothing, locations


MOST_EFFECTS = 7
"""In one hypothesis: a recording of the usual protocol does not distinguish more. The measurement
`benchmarks/search_ablation.py` searches without it."""

_WIDTH = 6
"""Sets that are grown at once: the place that helps most at first is not always in the best."""
_SCORED_EXACTLY = 4
"""Of the extensions of one effect with the best forecasts: a forecast has the weight of before."""
_GROWTH_COST_RATIO = 1.02
"""Sets stop growing where the cost without its penalty falls by less than this factor: a small
gain suffices, as many places alike are worth their penalty only together."""
_MOST_PAIRED = 40
"""Places of one effect up to which all pairs of them are tried: they grow as the square."""
_WEIGHTINGS = 2
"""Solutions of one set: at the weight of the whole residual, then of what is left."""


@dataclass(frozen=True)
class Proposal:
    """Effects to add to a hypothesis.

    Attributes:
        added: in the order in which they were chosen.
        coefficients: (K,) of their columns, scaled.
        beside: the hypothesis.
        forecast: cost of what the sum leaves on held-out trials, with the penalty.
        most_left: mean square; no fit if its starts leave more.
    """

    added: tuple[LinearEffect, ...]
    coefficients: Array
    beside: Hypothesis
    forecast: float
    most_left: float = np.inf

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of all effects, of the hypothesis and added, in alphabetical order."""
        return tuple(sorted({*self.beside.effects, *(e.effect for e in self.added)}))


_Scored = tuple[float, list[int]]
"""The cost with its penalty, and the chosen locations by their positions among those offered."""


class Selection:
    """Linear effects among which additions to one hypothesis are chosen."""

    def __init__(
        self, problem: Problem, about: Hypothesis, offered: Sequence[LinearEffect]
    ) -> None:
        self._problem = problem
        self._about = about
        self._offered = offered
        columns = [problem.nuisance_columns, about.columns, *(e.columns for e in offered)]
        self._base = len(problem.nuisance_columns) + len(about.columns)
        ends = self._base + np.cumsum([len(e.columns) for e in offered], dtype=np.int64)
        self._owned = [
            np.arange(n - len(e.columns), n) for n, e in zip(ends, offered, strict=True)
        ]
        fold_of_row = problem.fold[problem.trial]
        residual = problem.readings - about.without_nuisance - problem.nuisance_remainder
        self._columns = columns
        self._residual = residual
        self._data = products(np.concatenate(columns), residual, fold_of_row, problem.used)
        self._precision = np.concatenate([np.ones(self._base), *(e.precision for e in offered)])
        self._known = Counter(effect for effect, _ in about.locations)
        ranges = problem.parameters
        self._positive = [
            np.array(
                [ranges[term].low >= 0.0 and ranges[term].role == "size" for term in e.varied]
            )
            for e in offered
        ]

    def singles(self) -> list[Proposal]:
        """Each effect everywhere and in its best places, the most promising first."""
        return self._proposals(self._single_effects())

    def _single_effects(self) -> list[_Scored]:
        sides: dict[tuple[str, bool], list[int]] = {}
        for k, linear in enumerate(self._offered):
            sides.setdefault((linear.effect, linear.place == WHOLE_ARM), []).append(k)
        grown = (
            self._grown(side, strict=True) or self._grown(side, strict=False)
            for side in sides.values()
        )
        return sorted(filter(None, grown), key=lambda each: each[0])

    def additions(self) -> list[Proposal]:
        """For every set of effects that is promising their best places, most promising first."""
        singles = self._single_effects()
        best = {self._effects(chosen): (s, chosen) for s, chosen in reversed(singles)}
        level = sorted(best.values())[:_WIDTH]
        least = np.inf
        for _ in range(2 * MOST_EFFECTS):
            longer: dict[tuple[str, ...], _Scored] = {}
            for _, chosen in level:
                for score, extended in self._extended(chosen, range(len(self._offered))):
                    effects = self._effects(extended)
                    if score < longer.get(effects, (np.inf, []))[0]:
                        longer[effects] = score, extended
            tried = sorted(longer.values())[: 2 * _WIDTH]
            scored = [(self._score(chosen), chosen) for _, chosen in tried]
            level = sorted(each for each in scored if np.isfinite(each[0]))[:_WIDTH]
            for score, chosen in level:
                effects = self._effects(chosen)
                if score < best.get(effects, (np.inf, []))[0]:
                    best[effects] = score, chosen
            before = least
            least = min((s / self._penalty(c) for s, c in level), default=np.inf)
            if not level or _GROWTH_COST_RATIO * least > before:
                break
        # the linear score often errs about an effect everywhere and in places: both are tried
        others = (each for each in singles if each not in best.values())
        return self._proposals([*best.values(), *others])

    def _grown(self, among: Sequence[int], *, strict: bool) -> _Scored | None:
        """One effect's locations added while each, or two at once, is worth its penalty."""
        score = np.inf
        chosen = list[int]()
        while True:
            options = sorted(self._extended(chosen, among))[:_SCORED_EXACTLY]
            scored = [(self._score(option, strict=strict), option) for _, option in options]
            best = min(scored, default=(np.inf, chosen))
            if best[0] >= score or (not strict and chosen):
                return (score, chosen) if chosen else None
            score, chosen = best

    def _extended(self, chosen: Sequence[int], among: Sequence[int]) -> Iterator[_Scored]:
        """The chosen locations with one more, or two of one effect, each with a forecast."""
        by_effect: dict[str, list[int]] = {}
        for k in among:
            if self._fits(k, chosen):
                by_effect.setdefault(self._offered[k].effect, []).append(k)
        if not by_effect:
            return
        weight_ = weight(self._fitted(chosen)[1], self._problem.floor)
        for locations in by_effect.values():
            yield from self._extended_by(locations, chosen, weight_)

    def _extended_by(
        self, locations: Sequence[int], chosen: Sequence[int], weight_: float
    ) -> Iterator[_Scored]:
        """The chosen locations with one or two of an effect's, each with a forecast."""
        first = np.concatenate([np.arange(self._base), *(self._owned[k] for k in chosen)])
        order = np.concatenate([first, *(self._owned[k] for k in locations)])
        reduced = Reduced(
            self._data.columns(order),
            len(self._problem.nuisance_columns),
            len(first),
            self._precision[order],
            weight_,
        )
        ends = np.cumsum([len(self._owned[k]) for k in locations])
        positions = {
            k: np.arange(n - len(self._owned[k]), n) for k, n in zip(locations, ends, strict=True)
        }
        options = [[k] for k in locations]
        # of two cables that pull against each other, either alone may explain nothing
        parts = [k for k in locations if self._offered[k].place != WHOLE_ARM]
        if len(parts) <= _MOST_PAIRED:
            options += [
                [a, b]
                for a, b in combinations(parts, 2)
                if self._offered[a].place != self._offered[b].place
            ]
        by_count: dict[tuple[int, int], list[list[int]]] = {}
        for option in options:
            columns = sum(len(positions[k]) for k in option)
            by_count.setdefault((len(option), columns), []).append(option)
        for group in by_count.values():
            penalty = self._penalty([*chosen, *group[0]])
            sets = np.array([np.concatenate([positions[k] for k in option]) for option in group])
            mean_squares, chi2 = reduced.left(sets)
            for option, square, off in zip(group, mean_squares, chi2, strict=True):
                cost = self._problem.cost(float(square), float(off))
                yield cost * penalty, [*chosen, *option]

    def _fits(self, k: int, chosen: Sequence[int]) -> bool:
        """Whether a location may stand together with those that are chosen."""
        linear = self._offered[k]
        same = [self._offered[c].place for c in chosen if self._offered[c].effect == linear.effect]
        if not same and linear.effect not in self._known:
            return len({*self._known, *self._effects(chosen)}) < MOST_EFFECTS
        return linear.place not in same and (WHOLE_ARM not in {linear.place, *same} or not same)

    def _effects(self, chosen: Sequence[int]) -> tuple[str, ...]:
        names = {*self._about.effects, *(self._offered[k].effect for k in chosen)}
        return tuple(sorted(names))

    def _penalty(self, chosen: Sequence[int]) -> float:
        places = self._known + Counter(self._offered[k].effect for k in chosen)
        return self._problem.penalty(places)

    def _score(self, chosen: Sequence[int], *, strict: bool = True) -> float:
        """Cost with the penalty, at the weight of its residual; infinite for impossible sizes."""
        coefficients, mean_square, chi2 = self._fitted(chosen)
        positive = np.concatenate([np.zeros(0, dtype=bool), *(self._positive[k] for k in chosen)])
        if strict and (coefficients[self._base :][positive] < 0.0).any():
            return np.inf
        return self._problem.cost(mean_square, chi2) * self._penalty(chosen)

    def _proposals(self, found: Iterable[_Scored]) -> list[Proposal]:
        """Proposals of scored choices, the most promising first."""
        proposals = [
            Proposal(
                added=tuple(self._offered[k] for k in chosen),
                coefficients=self._fitted(chosen)[0][self._base :],
                beside=self._about,
                forecast=score,
            )
            for score, chosen in found
        ]
        return sorted(proposals, key=lambda proposal: proposal.forecast)

    def left_by(self, proposal: Proposal) -> Array:
        """The residual (R, C) of one of its proposals, nuisance parameters fitted along."""
        chosen = [k for k, each in enumerate(self._offered) if each in proposal.added]
        columns = [*self._columns[:2], *(self._offered[k].columns for k in chosen)]
        coefficients = self._fitted(chosen)[0]
        return self._residual - np.tensordot(coefficients, np.concatenate(columns), axes=1)

    def kept(self) -> list[int]:
        """Offered locations that are worth their penalty: one, or an effect, goes at a time."""
        chosen = list(range(len(self._offered)))
        score = self._score(chosen, strict=False)
        while len(chosen) > 1:
            names = {self._offered[k].effect for k in chosen}
            fewer = [[c for c in chosen if c != k] for k in chosen]
            fewer += [[c for c in chosen if self._offered[c].effect != name] for name in names]
            tried = [(self._score(f, strict=False), f) for f in fewer if f]
            best = min(tried, default=(np.inf, chosen))
            if best[0] >= score:
                break
            score, chosen = best
        return chosen

    def left_without(self, effect: str) -> float:
        """The cost of all offered locations without one effect."""
        rest = [k for k, linear in enumerate(self._offered) if linear.effect != effect]
        return self._problem.cost(*self._fitted(rest)[1:])

    def _fitted(self, chosen: Sequence[int]) -> tuple[Array, float, float]:
        """Coefficients, the mean square left on held-out trials, and the nuisance chi-square."""
        column_indices: Indices = np.concatenate(
            [np.arange(self._base), *(self._owned[k] for k in chosen)]
        )
        part = self._data.columns(column_indices)
        precision = self._precision[column_indices]
        zero_offset = np.zeros(len(column_indices))
        count = part.count.sum()
        mean_square = self._data.mean_square
        problem = self._problem
        nuisance = len(problem.nuisance_columns)
        for _ in range(_WEIGHTINGS):
            weight_ = weight(mean_square, problem.floor)
            squares_left = held_out_squares(part, nuisance, precision, zero_offset, weight_)
            mean_square = float(squares_left.sum() / count)
        coefficients = solve(part.gram.sum(0), part.moment.sum(0), precision, zero_offset, weight_)
        chi2 = float((coefficients[:nuisance] ** 2).sum())
        return coefficients, mean_square, chi2
