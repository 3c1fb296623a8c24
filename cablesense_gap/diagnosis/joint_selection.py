"""Several effects at once: effects are added, exchanged and left out, all numbers fitted together.

Every step is linear about what was found so far, and judged on held-out trials; the simulator
itself then fits what is promising. An effect stays only where leaving it out makes held-out trials
worse by more than chance over the trials.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from cablesense_gap.diagnosis.gauss_newton import refit
from cablesense_gap.diagnosis.places import LinearEffect, Placing, linear_effects, place
from cablesense_gap.diagnosis.problem import Hypothesis, Problem, to_scaled
from cablesense_gap.diagnosis.screening import Offered, Screened, screen_pairs
from cablesense_gap.simulator import Candidate, Term, parameters_of
from cablesense_sim.effects.effect import WHOLE_ARM

Spread = Callable[[Callable[..., Any], Iterable[Any]], Iterable[Any]]
Fit = Callable[[Problem, Screened], Hypothesis | None]

_MOST_EFFECTS = 7
_MOST_CHANGES, _MOST_EXCHANGES = 10, 2
_TRIED = 3
_PROMISING = 2.0
_STEPS_AGAIN = 3
_PLACE_WORTH = 1.04
_EFFECT_WORTH = 1.08
_ELSEWHERE = 0.04
"""Power of the number of places among which one is chosen."""
_SIZE_WORTH = 1.005
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
        every = problem.simulator.candidates
        self._worth = {c.effect: max(_PLACE_WORTH, len(c.places) ** _ELSEWHERE) for c in every}

    def run(self, start: Hypothesis, enough: Callable[[Hypothesis], bool]) -> Iterator[Hypothesis]:
        """Every explanation on the way from `start`, the last one the best."""
        best, exchanges = start, 0
        for _ in range(_MOST_CHANGES):
            if enough(best):
                break
            offered = self._offered(best)
            better = self._best_of(self._added(best, offered), best)
            if better is None and exchanges < _MOST_EXCHANGES:
                exchanges += 1
                better = self._best_of(self._exchanged(best, offered), best)
            if better is None:
                break
            best = self._without_idle(better)
            yield best

    def _offered(self, about: Hypothesis) -> Offered:
        linear = self._spread(partial(_linear_about, about), self._candidates)
        whole = {t.effect for t in about.values if t.place == WHOLE_ARM}
        single = {t.effect for t in about.values} - whole
        others = {e: shapes for e, shapes in self._known.items() if e not in about.effects}
        return others | {
            c.effect: [
                tuple(e for e in every if c.effect not in single or e.place != WHOLE_ARM)
                for every in shapes
            ]
            for c, shapes in zip(self._candidates, linear, strict=True)
            if c.effect not in whole
        }

    def _added(self, beside: Hypothesis, offered: Offered, *, two: bool = True) -> list[Screened]:
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

    def _exchanged(self, hypothesis: Hypothesis, offered: Offered) -> list[Screened]:
        """Each effect that others may stand in for taken out, and another one put in."""
        found = []
        for rest in left_out(self._spread, hypothesis, self._idle(hypothesis, 3.0)):
            found += self._added(rest, offered, two=False)[:_TRIED]
        return sorted(found, key=self._forecast)

    def _best_of(self, screened: Sequence[Screened], than: Hypothesis) -> Hypothesis | None:
        """The best of the most promising, fitted; None where none is worth it."""
        before = self._judged(than)
        least = min(map(self._forecast, screened[:1]), default=np.inf)
        most = min(before, _PROMISING * least)
        tried = [s for s in screened[:_TRIED] if self._forecast(s) <= most]
        fitted = [h for h in self._spread(self._fit, tried) if h is not None]
        best = min(fitted, key=self._judged, default=None)
        return best if best is not None and self._judged(best) < before else None

    def _forecast(self, screened: Screened) -> float:
        placed, beside = screened.placed, screened.beside
        values = () if beside is None else tuple(beside.values)
        sites = [e.terms[0][:2] for e in placed.chosen] + [t[:2] for t in values]
        count = len(values) + sum(len(e.probed) for e in placed.chosen)
        return self._penalised(
            self._problem.cost(placed.mean_square, placed.tolerance_chi2), sites, count
        )

    def _judged(self, hypothesis: Hypothesis) -> float:
        sites = [term[:2] for term in hypothesis.values]
        return self._penalised(self._problem.cost_of(hypothesis), sites, len(hypothesis.values))

    def _penalised(self, cost: float, sites: Sequence[tuple[str, str]], count: int) -> float:
        """What is left, with a penalty for each effect, each place among many, and each number."""
        for effect, _ in set(sites):
            cost *= self._worth[effect]
        return cost * _EFFECT_WORTH ** len({e for e, _ in sites}) * _SIZE_WORTH**count

    def _without_idle(self, hypothesis: Hypothesis) -> Hypothesis:
        """Effects are left out as long as held-out trials hardly notice."""
        while len(hypothesis.effects) > 1:
            rests = [
                rest
                for rest in left_out(self._spread, hypothesis, self._idle(hypothesis, _PROMISING))
                if self._judged(rest) <= self._judged(hypothesis)
                or not borne_out(hypothesis, rest)
            ]
            if not rests:
                break
            hypothesis = min(rests, key=self._judged)
        return hypothesis

    def _idle(self, hypothesis: Hypothesis, factor: float) -> list[str]:
        """Effects without which no more than a factor of what is left would be left, linearly."""
        most = factor * self._problem.cost_of(hypothesis)
        return [
            e for e in hypothesis.effects if _cost_without(self._problem, hypothesis, e) < most
        ]


def left_out(
    spread: Spread, hypothesis: Hypothesis, effects: Sequence[str] | None = None
) -> list[Hypothesis]:
    """The hypothesis without each of its effects, all other numbers refitted."""
    rests: list[dict[Term, float]] = [
        {t: v for t, v in hypothesis.values.items() if t.effect != effect}
        for effect in (hypothesis.effects if effects is None else effects)
    ]
    return [h for h in spread(_refitted, rests) if h is not None]


def _refitted(problem: Problem, values: Mapping[Term, float]) -> Hypothesis | None:
    return refit(problem, values, _STEPS_AGAIN)


def _linear_about(
    about: Hypothesis, problem: Problem, candidate: Candidate
) -> list[tuple[LinearEffect, ...]]:
    return linear_effects(problem, candidate, about)


def borne_out(better: Hypothesis, worse: Hypothesis) -> bool:
    """Whether one leaves less on held-out trials than the other by more than chance over them."""
    gain = worse.squares - better.squares
    return bool(gain.sum() > _CHANCE * np.sqrt(len(gain)) * gain.std())


def _cost_without(problem: Problem, hypothesis: Hypothesis, effect: str) -> float:
    """What leaving an effect out would cost, linear about the fit."""
    own = np.array([term.effect == effect for term in hypothesis.values])
    ranges = parameters_of(problem.simulator.candidates)
    gone = problem.readings - hypothesis.without_tolerances
    for column, (term, value) in zip(hypothesis.columns, hypothesis.values.items(), strict=True):
        if term.effect == effect and ranges[term].role == "size":
            gone = gone + to_scaled(ranges[term], value) * column
    placed = Placing(problem, gone, hypothesis.columns[~own], ()).placed(())
    return problem.cost(placed.mean_square, placed.tolerance_chi2)
