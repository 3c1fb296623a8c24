"""The part of an explanation that is certain although something unlisted acts as well.

An explanation is a set S of listed effects, with or without an unlisted remainder. Where the
remainder acts in the readings E (`diagnosis.extent`), the others are explained by S alone, and the
posterior of any recording holds there; where it acts in all of them, it takes what S leaves
(`posterior_beside_unlisted`). With p, the probability that something unlisted acts at all,

    P(effect) = (1 - p) P(effect | nothing unlisted) + p P(effect | E)

for the extent E that decides most. docs/decisions.md derives it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import NamedTuple, TypeVar

import numpy as np

from cablesense_gap.diagnosis import fitting
from cablesense_gap.diagnosis.extent import (
    Extent,
    Screened,
    over_all_readings,
    screened_extents,
    without_extent,
)
from cablesense_gap.diagnosis.nuisance import final_refinement
from cablesense_gap.diagnosis.probability import (
    EQUAL,
    UNKNOWN,
    ProbabilityCalibration,
    Ranked,
    imitating_best,
    log_weights,
    named,
    posterior,
    posterior_beside_unlisted,
    probability_of_unlisted,
    probability_unlisted,
    without,
)
from cablesense_gap.diagnosis.problem import Hypothesis, Problem
from cablesense_gap.diagnosis.search import is_redundant
from cablesense_gap.explained import removes
from cablesense_gap.system import System

_FITTED = 2
"""Extents to which effects are fitted, those with the best linear forecasts."""
_PROPOSED = 6
"""Additions that are fitted outside an extent: as many as a search starts from."""
_KNOWN = 3
"""Hypotheses of all readings that are fitted there again."""
_STEPS = 3
"""Gauss-Newton steps of these, which are near their best values already."""


@dataclass(frozen=True)
class PartialAnswer:
    """Listed effects that are certain beside something unlisted.

    Attributes:
        extent: of the remainder.
        problem: the readings outside the extent; all, if it is of all.
        beside: hypotheses fitted to these, the named one first, with the probabilities that
            exactly their effects act beside something unlisted.
        ranked: all explanations, the named one first; its hypothesis is of all readings.
    """

    extent: Extent
    problem: Problem
    beside: tuple[Ranked, ...]
    ranked: tuple[Ranked, ...]

    def explains_the_rest(self, calibration: ProbabilityCalibration) -> bool:
        """Whether the effects leave nothing in any channel outside the extent."""
        best = self.beside[0].hypothesis
        if self.extent.is_whole or best is None:
            return False
        left = (self.problem.readings - best.held_out)[self.problem.used]
        return all(
            probability_unlisted(float(rmse), self.problem.floor, calibration) < 0.5
            for rmse in np.sqrt((left**2).mean(0))
        )


def named_that_removes(
    problem: Problem, ranked: Sequence[Ranked], calibration: ProbabilityCalibration
) -> list[Ranked]:
    """The hypotheses, first the one that the verdict names: one whose effects remove something.

    One that removes nothing is no hypothesis: the others share its probability.
    """
    while True:
        chosen = named(problem, ranked, calibration)
        best = chosen[0].hypothesis
        if best is None or not best.effects or removes(problem, best):
            return chosen
        ranked = without(ranked, best)


def partial_answer(
    system: System,
    problem: Problem,
    ranked: Sequence[Ranked],
    calibration: ProbabilityCalibration,
    progress: Callable[[str, float], None] = lambda *_: None,
) -> PartialAnswer | None:
    """The listed effects that are certain although something unlisted acts; None without any.

    `ranked` are the hypotheses without anything unlisted, and an unlisted effect alone. Of the
    extents the one is taken in which the named effects are most probable.
    """
    hypotheses = [r.hypothesis for r in ranked if r.hypothesis is not None]
    everywhere = posterior_beside_unlisted(hypotheses, problem.floor, calibration)
    answers = [_Answer(Extent.whole(problem), problem, _named_beside(problem, everywhere))]
    progress("separating what is unlisted", 0.97)
    screened = list(screened_extents(problem, system.channel_groups()))
    forecasts = [_forecast(each, problem.floor, calibration) for each in screened]
    pairs = zip(forecasts, screened, strict=True)
    promising = [(forecast, each) for forecast, each in pairs if forecast > 0.5]
    for each in _smallest(promising, _FITTED):
        others = without_extent(problem, each.extent)
        fitted = system.completed(others, _hypotheses(others, each, hypotheses))
        costly = [_with_choices(h, each.extent) for h in fitted]
        beside = posterior(costly, others.floor, calibration)
        answers.append(_Answer(each.extent, others, _named_beside(others, beside)))
    certain = [answer for answer in answers if answer.beside]
    if not certain:
        return None
    (answer,) = _smallest([(each.beside[0].probability, each) for each in certain], 1)
    unlisted = probability_of_unlisted(hypotheses, problem.floor, calibration)
    return _of_whole(problem, ranked, unlisted, answer)


_WithExtent = TypeVar("_WithExtent", "_Answer", Screened)


class _Answer(NamedTuple):
    """Hypotheses given an extent, the named one first."""

    extent: Extent
    problem: Problem
    beside: list[Ranked]


def _smallest(extents: Iterable[tuple[float, _WithExtent]], most: int) -> list[_WithExtent]:
    """The smallest of the extents that make effects about as probable as any does.

    The remainder reaches no farther than it must.
    """
    pairs = list(extents)
    least = EQUAL * max((probability for probability, _ in pairs), default=0.0)
    probable = [each for probability, each in pairs if probability >= least]
    return sorted(probable, key=lambda each: each.extent.share)[:most]


def _hypotheses(
    problem: Problem, screened: Screened, known: Sequence[Hypothesis]
) -> list[Hypothesis]:
    """What explains the readings outside an extent: without effects first, one for each set.

    The best additions by their linear forecasts, those of the `known` hypotheses that leave least
    there, and the best of all without each of its effects.
    """
    best: dict[tuple[str, ...], Hypothesis] = {}

    def keep(fitted: Iterable[Hypothesis | None]) -> None:
        for each in fitted:
            if each is None or not each.effects:
                continue
            if each.effects not in best or problem.score(each) < problem.score(best[each.effects]):
                best[each.effects] = each

    keep(chain.from_iterable(fitting.fit(problem, p) for p in screened.proposals[:_PROPOSED]))
    kept = ~screened.extent.channels
    left = {
        k: float(((problem.readings - h.held_out[:, kept])[problem.used] ** 2).mean())
        for k, h in enumerate(known)
        if h.effects and h.effects not in best
    }
    for k in sorted(left, key=lambda k: left[k])[:_KNOWN]:
        keep([fitting.refit(problem, known[k].values, _STEPS)])
    if best:
        first = min(best.values(), key=problem.score)
        keep([final_refinement(problem, first)[0]])
        first = best[first.effects]
        if len(first.effects) > 1:
            keep(fitting.without(problem, [effect], first) for effect in first.effects)
    fitted_hypotheses = list(best.values())
    worth_it = [
        each for each in fitted_hypotheses if not is_redundant(problem, each, fitted_hypotheses)
    ]
    without_effects = fitting.refine(problem, {}, [[]])
    assert without_effects is not None
    return [without_effects, *worth_it]


def _named_beside(problem: Problem, beside: Sequence[Ranked]) -> list[Ranked]:
    """The hypotheses, first the one that is named beside an unlisted effect; none if none is.

    What the recording cannot distinguish from the named one counts with it against all others.
    """
    while True:
        listed = [r for r in beside if r.hypothesis is not None and r.hypothesis.effects]
        if not listed:
            return []
        together = imitating_best(problem, beside)
        nothing_listed = sum(r.probability for r in beside if r not in listed)
        if sum(r.probability for r in together) <= nothing_listed:
            return []
        best = together[0]
        assert best.hypothesis is not None
        if removes(problem, best.hypothesis):
            return [best, *(r for r in beside if r is not best)]
        beside = without(beside, best.hypothesis)


def _with_choices(hypothesis: Hypothesis, extent: Extent) -> Hypothesis:
    """A hypothesis that pays for the choice of the extent that makes its effects certain."""
    if not hypothesis.effects:
        return hypothesis
    penalty = hypothesis.log_prior_penalty + extent.log_choices
    return replace(hypothesis, log_prior_penalty=penalty)


def _forecast(screened: Screened, floor: float, calibration: ProbabilityCalibration) -> float:
    """The probability of the best listed effects against something unlisted outside the extent."""
    if not screened.proposals:
        return 0.0
    alone = screened.without_effects
    left = [np.hypot(p.forecast, floor) for p in screened.proposals]
    counts = [len(p.effects) for p in screened.proposals]
    sizes = [len(p.coefficients) for p in screened.proposals]
    chi2 = np.zeros(len(left) + 1)
    weights = log_weights(
        np.array([alone.held_out_rmse, *left]),
        np.array([0, *counts]),
        np.array([0, *sizes]),
        chi2,
        1.0,
        floor,
        calibration,
    )
    nothing_listed = np.logaddexp(weights[0], weights[-1]) + screened.extent.log_choices
    return float(1.0 / (1.0 + np.exp(nothing_listed - weights[1:-1].max())))


def _of_whole(
    problem: Problem, ranked: Sequence[Ranked], unlisted: float, answer: _Answer
) -> PartialAnswer:
    """The answer with the probabilities of the whole; something unlisted acts with `unlisted`."""
    scaled = [
        replace(r, probability=unlisted * r.probability, remainder=True)
        for r in answer.beside
        if r.hypothesis is not None and r.hypothesis.effects
    ]
    whole = scaled[0].hypothesis
    assert whole is not None
    if not answer.extent.is_whole:
        whole = over_all_readings(problem, answer.extent, whole)
    bare = unlisted - sum(r.probability for r in scaled)
    listed_alone = [r for r in ranked if r.hypothesis is not None]
    share = (1.0 - unlisted) / sum(r.probability for r in listed_alone)
    alone = [replace(r, probability=share * r.probability) for r in listed_alone]
    rest = [*scaled[1:], *alone, Ranked(UNKNOWN, max(bare, 0.0), None)]
    rest.sort(key=lambda r: -r.probability)
    return PartialAnswer(
        answer.extent, answer.problem, tuple(scaled), (replace(scaled[0], hypothesis=whole), *rest)
    )
