"""Several effects at once: effects are added, exchanged and left out, all numbers fitted together.

Effects are added linear about what was found so far, as long as each helps a little on held-out
trials: of four alike, the first takes away an eighth of what is left, and the last all of it. The
simulator itself then fits them all, and only then each must be worth its place: it stays where
leaving it out makes held-out trials worse by more than chance over the trials.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import chain, combinations
from math import comb
from typing import Any

import numpy as np

from cablesense_gap.diagnosis.gauss_newton import refit_part
from cablesense_gap.diagnosis.places import LinearEffect, Placing, linear_effects, place
from cablesense_gap.diagnosis.problem import (
    Explanation,
    Problem,
    prior_precision,
    to_scaled,
)
from cablesense_gap.diagnosis.screening import Offered, Screened, screen_pairs
from cablesense_gap.simulator import Candidate, Term, parameters_of
from cablesense_sim.effects.effect import WHOLE_ARM

Spread = Callable[[Callable[..., Any], Iterable[Any]], Iterable[Any]]
Fit = Callable[[Problem, Screened], Explanation | None]

_MOST_EFFECTS, _MOST_ADDED = 7, 14
"""In one explanation, and effects and places that are added to it at once."""
_MOST_CHANGES, _MOST_EXCHANGES, _STEPS_AGAIN = 10, 2, 3
_SEVERAL = 3
"""Beside fewer effects two at once are tried as well."""
_TRIED, _REPLACED = 3, 5
"""Of those screened the most promising ones are fitted."""
_PROMISING, _EXCHANGED = 2.0, 10.0
"""What leaves at most so many times as much is tried, and can be missed for another effect."""
_HELPS, _BETTER, _SLIGHTLY = 1.02, 0.95, 0.99
"""By how much each added one makes what is left smaller, and what is left as a share of before."""
_EFFECT_WORTH, _FURTHER_WORTH, _SIZE_WORTH = 1.08, 1.02, 1.003
"""By which factor an effect, a place and a number each make what is left smaller, to be kept."""
_PLACE_WORTH, _ELSEWHERE = 1.03, 0.02
"""The least factor for an effect's places, and the power of the number of choices of as many."""
_CHANCE = 1.28
"""Standard deviations over trials; less may be chance."""


class JointSelection:
    """Grows one explanation by effects and places, as long as held-out trials bear it out."""

    def __init__(
        self,
        problem: Problem,
        spread: Spread,
        candidates: Sequence[Candidate],
        fit: Fit,
        known: Offered,
    ) -> None:
        """`spread` gives what a function makes of the problem and each of some values.

        `candidates` are simulated about each fit, others `known` as they are; `fit` begins from
        what screening finds.
        """
        self._problem, self._spread, self._fit = problem, spread, fit
        self._candidates, self._known = candidates, known
        self._places = {c.effect: len(c.places) for c in problem.simulator.candidates}

    def run(
        self,
        start: Explanation,
        enough: Callable[[Explanation], bool],
        nearly: Callable[[Explanation], bool],
    ) -> Iterator[Explanation]:
        """Every explanation on the way from `start`, the last one the best.

        What is nearly enough is only added to, and two effects at once are tried beside few.
        """
        best, exchanges = start, 0
        for _ in range(_MOST_CHANGES):
            if enough(best):
                break
            offered = self._offered(best)
            better = self._best_of(self._grown(best, offered), best)
            if better is None and nearly(best):
                break
            if better is None:
                few = len(best.effects) < _SEVERAL
                better = self._best_of(self._added(best, offered, two=few), best)
            if better is None and exchanges < _MOST_EXCHANGES:
                exchanges += 1
                better = self._best_of(self._exchanged(best, offered), best)
            if better is None:
                break
            best = better
            yield best

    def _offered(self, about: Explanation) -> Offered:
        linear = self._spread(partial(_linear_about, about), self._candidates)
        own = zip((c.effect for c in self._candidates), linear, strict=True)
        taken = {term[:2] for term in about.values}

        def is_left(effect: str, place: str) -> bool:
            beside = place == WHOLE_ARM and effect in about.effects
            return not beside and (effect, place) not in taken

        return {
            effect: [tuple(e for e in every if is_left(effect, e.place)) for every in shapes]
            for effect, shapes in chain(self._known.items(), own)
            if (effect, WHOLE_ARM) not in taken
        }

    def _grown(self, beside: Explanation, offered: Offered) -> list[Screened]:
        """Effects and places added one by one, as long as each helps."""
        sites = [
            (effect, linear)
            for effect, shapes in offered.items()
            for every in shapes
            for linear in every
        ]
        if not sites:
            return []
        residual = self._problem.readings - beside.without_tolerances
        placing = Placing(self._problem, residual, beside.columns, [linear for _, linear in sites])

        def is_left(k: int, chosen: Sequence[int]) -> bool:
            effect, linear = sites[k]
            same = {sites[c][1].place for c in chosen if sites[c][0] == effect}
            names = {*beside.effects, *(sites[c][0] for c in chosen)}
            if effect not in names:
                return len(names) < _MOST_EFFECTS
            return linear.place not in same and not (same and WHOLE_ARM in {linear.place, *same})

        def worth(more: Sequence[int]) -> float:
            return _HELPS * _SIZE_WORTH ** sum(len(sites[k][1].probed) for k in more)

        ranges = parameters_of(self._problem.simulator.candidates)
        chosen: list[int] = []
        impossible: set[int] = set()
        left = placing.left(chosen)
        while len(chosen) < _MOST_ADDED:
            every = set(range(len(sites))) - impossible
            rest = [[k] for k in sorted(every) if is_left(k, chosen)]
            further, penalised = placing.best(chosen, rest, worth)
            if penalised >= left:
                break
            placed = placing.placed(further)
            last = sites[further[-1]][1]
            sizes = placed.coefficients[-len(last.probed) :]
            own = zip(last.probed, sizes, strict=True)
            low = {term.parameter: ranges[term].low for term in last.terms}
            if any(size < 0.0 <= low[name] for name, size in own):
                impossible.add(further[-1])
                continue
            chosen, left = further, placing.left(further)
        return [Screened(placing.placed(chosen), beside)] if chosen else []

    def _added(self, beside: Explanation, offered: Offered, *, two: bool = True) -> list[Screened]:
        """One effect or two in their best places, or in further ones, beside what is there."""
        problem = self._problem
        residual = problem.readings - beside.without_tolerances
        found = []
        for shapes in offered.values():
            tried = [place(problem, residual, beside.columns, every) for every in shapes if every]
            best = min(tried, key=lambda p: p[0].mean_square, default=[])
            found += [Screened(p, beside) for p in best[:1]]
        if two and found:
            least = min(s.placed.mean_square for s in found)
            found += screen_pairs(problem, offered, least, beside)
        few = [s for s in found if len(s.effects) <= _MOST_EFFECTS]
        return sorted(few, key=self._forecast)

    def replaced(self, best: Explanation) -> Iterator[Explanation]:
        """Explanations with one or two effects taken out, and another one put in or none.

        They go on from what is better, or as good with fewer numbers. What is put in is linear
        about the nominal mechanism: beside what it is to replace, as a mass beside a shifted
        centre, it would have nothing to do. So it is forecast roughly.
        """
        nominal = list(chain(*chain(*self._spread(linear_effects, self._candidates))))
        for _ in range(_MOST_CHANGES):
            gone = chain.from_iterable(combinations(best.effects, n) for n in (1, 2))
            rests = left_out(self._spread, best, list(gone))
            others = [e for e in nominal if e.terms[0].effect not in best.effects]
            screened = chain(*(self._with_another(rest, others) for rest in rests if others))
            tried = sorted(screened, key=self._forecast)[:_REPLACED]
            fitted = [h for h in self._spread(self._fit, tried) if h is not None]
            found = [*(rest for rest in rests if rest.effects), *fitted]
            most = _PROMISING * self._judged(best)
            yield from (each for each in found if self._judged(each) < most)
            better = min(found, key=self._judged, default=best)
            if self._judged(better) >= _SLIGHTLY * self._judged(best):
                break
            best = better

    def _with_another(self, rest: Explanation, others: Sequence[LinearEffect]) -> list[Screened]:
        """Each other effect in its best places, everywhere at once and not."""
        residual = self._problem.readings - rest.without_tolerances
        placing = Placing(self._problem, residual, rest.columns, others)
        sites: dict[tuple[str, bool], list[int]] = {}
        for k, linear in enumerate(others):
            sites.setdefault((linear.terms[0].effect, linear.place == WHOLE_ARM), []).append(k)
        return [Screened(placing.placed(placing.grow(own)[0]), rest) for own in sites.values()]

    def _exchanged(self, explanation: Explanation, offered: Offered) -> list[Screened]:
        """Each effect that others may stand in for taken out, and another one put in."""
        found = []
        for rest in left_out(self._spread, explanation, self._idle(explanation, _EXCHANGED)):
            found += self._added(rest, offered, two=False)[:_TRIED]
        return sorted(found, key=self._forecast)

    def _best_of(self, screened: Sequence[Screened], than: Explanation) -> Explanation | None:
        """The best of the most promising, fitted; None where none is worth it."""
        before = self._judged(than)
        least = min(map(self._forecast, screened[:1]), default=np.inf)
        tried = [s for s in screened[:_TRIED] if self._forecast(s) <= _PROMISING * least]
        fitted = [h for h in self._spread(self._fit, tried) if h is not None]
        smaller = [(h, v) for h in fitted if len(v := self._pruned(h)) < len(h.values)]
        fitted += [h for h in self._spread(_refitted, smaller) if h is not None]
        best = min(fitted, key=self._judged, default=None)
        if best is None or self._judged(best) >= _BETTER * before:
            return None
        best = self._without_idle(best)
        return best if self._judged(best) < _BETTER * before else None

    def _forecast(self, screened: Screened) -> float:
        placed, beside = screened.placed, screened.beside
        values = () if beside is None else tuple(beside.values)
        sites = [e.terms[0][:2] for e in placed.chosen] + [t[:2] for t in values]
        count = len(values) + sum(len(e.probed) for e in placed.chosen)
        return self._penalised(
            self._problem.cost(placed.mean_square, placed.tolerance_chi2), sites, count
        )

    def _judged(self, explanation: Explanation) -> float:
        sites = [term[:2] for term in explanation.values]
        return self._penalised(self._problem.cost_of(explanation), sites, len(explanation.values))

    def _penalised(self, cost: float, sites: Sequence[tuple[str, str]], count: int) -> float:
        """What is left, with a penalty for each effect, each place among many, and each number."""
        taken = Counter(effect for effect, _ in set(sites))
        for effect, places in taken.items():
            choices = comb(self._places[effect], places)
            cost *= _EFFECT_WORTH * max(_PLACE_WORTH, float(choices) ** _ELSEWHERE)
        return cost * _FURTHER_WORTH ** taken.total() * _SIZE_WORTH**count

    def _pruned(self, fitted: Explanation) -> dict[Term, float]:
        """The values in those places without which more would be left, linear about the fit."""
        sites = list(dict.fromkeys(term[:2] for term in fitted.values))
        counts = [sum(term[:2] == site for term in fitted.values) for site in sites]
        placing = _own_places(self._problem, fitted, sites)

        def judged(kept: Sequence[int]) -> float:
            own = [sites[k] for k in kept]
            return self._penalised(placing.left(kept), own, sum(counts[k] for k in kept))

        kept = list(range(len(sites)))
        left = judged(kept)
        while kept:
            gone = [{k} for k in kept] + [
                {k for k in kept if sites[k][0] == effect} for effect in fitted.effects
            ]
            fewer = [[k for k in kept if k not in each] for each in gone]
            best = min((f for f in fewer if f and len(f) < len(kept)), key=judged, default=kept)
            if best is kept or judged(best) >= left:
                break
            kept, left = best, judged(best)
        stay = {sites[k] for k in kept}
        return {term: value for term, value in fitted.values.items() if term[:2] in stay}

    def _without_idle(self, explanation: Explanation) -> Explanation:
        """Effects are left out as long as held-out trials hardly notice."""
        while len(explanation.effects) > 1:
            rests = [
                rest
                for rest in left_out(
                    self._spread, explanation, self._idle(explanation, _PROMISING)
                )
                if self._judged(rest) <= self._judged(explanation)
                or not borne_out(explanation, rest)
            ]
            if not rests:
                break
            explanation = min(rests, key=self._judged)
        return explanation

    def _idle(self, explanation: Explanation, factor: float) -> list[tuple[str]]:
        """Effects without which no more than a factor of what is left would be left, linearly."""
        sites = list(dict.fromkeys(term[:2] for term in explanation.values))
        placing = _own_places(self._problem, explanation, sites)
        most = factor * self._problem.cost_of(explanation)

        def without(effect: str) -> float:
            return placing.left([k for k, site in enumerate(sites) if site[0] != effect])

        return [(effect,) for effect in explanation.effects if without(effect) < most]


def left_out(
    spread: Spread, explanation: Explanation, effects: Sequence[tuple[str, ...]] | None = None
) -> list[Explanation]:
    """The explanation without each of its effects, or some of them, all other numbers refitted."""
    gone = [(effect,) for effect in explanation.effects] if effects is None else effects
    rests = [
        (explanation, {t: v for t, v in explanation.values.items() if t.effect not in each})
        for each in gone
    ]
    return [h for h in spread(_refitted, rests) if h is not None]


def _refitted(
    problem: Problem, some: tuple[Explanation, Mapping[Term, float]]
) -> Explanation | None:
    return refit_part(problem, *some, _STEPS_AGAIN)


def _linear_about(
    about: Explanation, problem: Problem, candidate: Candidate
) -> list[tuple[LinearEffect, ...]]:
    return linear_effects(problem, candidate, about)


def borne_out(better: Explanation, worse: Explanation) -> bool:
    """Whether one leaves less on held-out trials than the other by more than chance over them."""
    gain = worse.squares - better.squares
    return bool(gain.sum() > _CHANCE * np.sqrt(len(gain)) * gain.std())


def _own_places(
    problem: Problem, fitted: Explanation, sites: Sequence[tuple[str, str]]
) -> Placing:
    """The sites of a fit to choose among, linear about it; sizes that it held at zero stay so."""
    ranges = parameters_of(problem.simulator.candidates)
    free = [value != 0.0 or ranges[term].low < 0.0 for term, value in fitted.values.items()]
    residual = problem.readings - fitted.without_tolerances
    for column, (term, value) in zip(fitted.columns, fitted.values.items(), strict=True):
        if ranges[term].role == "size":
            residual = residual + to_scaled(ranges[term], value) * column
    offered = []
    for site in sites:
        own = [k for k, term in enumerate(fitted.values) if term[:2] == site and free[k]]
        terms = tuple(term for k, term in enumerate(fitted.values) if k in own)
        precision = np.array([prior_precision(ranges[term]) for term in terms])
        names = tuple(term.parameter for term in terms)
        offered.append(
            LinearEffect(site[1], terms, np.zeros(len(own)), fitted.columns[own], precision, names)
        )
    return Placing(problem, residual, fitted.columns[:0], offered)
