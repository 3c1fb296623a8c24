"""What explains a recording: listed effects, alone or beside something unlisted.

An explanation is a set S of listed effects, and an extent E of the readings in which something
unlisted acts as well: none of them, all of them, or some channels or trials. Outside E, S explains
all that there is; in E it takes its share, and the unlisted effect has the rest
(`probability.log_weights_beside_unlisted`). All explanations are weighed together, so

    P(S) = Σ_E P(S, E)

and an effect is as probable as the sets that have it. docs/diagnosis_method.md derives it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import NamedTuple

import numpy as np

from cablesense_base import Array
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
    NONE_ALONE,
    UNKNOWN_ALONE,
    Fits,
    ProbabilityCalibration,
    Ranked,
    in_order,
    log_weights_alone,
    log_weights_beside_unlisted,
    named,
    posterior,
    probability_unlisted,
)
from cablesense_gap.diagnosis.problem import Hypothesis, Problem
from cablesense_gap.diagnosis.search import is_redundant
from cablesense_gap.explained import Changes, removes
from cablesense_gap.system import System

_MOST_EXTENTS = 2
"""Extents outside which effects are fitted, those with the best linear forecasts."""
_MOST_PROPOSALS = 6
"""Additions that are fitted outside an extent: as many as a search starts from."""
_MOST_KNOWN = 3
"""Hypotheses of all readings that are fitted there again."""
_REFIT_STEPS = 3
"""Gauss-Newton steps of these, which are near their best values already."""


@dataclass(frozen=True)
class Beside:
    """Something unlisted that acts beside the named effects.

    Attributes:
        extent: where it acts.
        problem: the readings outside the extent; all, if it acts in all.
        ranked: hypotheses fitted to these, the named one first.
    """

    extent: Extent
    problem: Problem
    ranked: tuple[Ranked, ...]

    def nothing_elsewhere(self, calibration: ProbabilityCalibration) -> bool:
        """Whether the effects leave nothing in any channel outside the extent."""
        best = self.ranked[0].hypothesis
        if self.extent.is_whole or best is None:
            return False
        residual = (self.problem.readings - best.held_out)[self.problem.used]
        return all(
            probability_unlisted(float(rmse), self.problem.floor, calibration) < 0.5
            for rmse in np.sqrt((residual**2).mean(0))
        )


@dataclass(frozen=True)
class Explanations:
    """All explanations of a recording, each set of effects once.

    Attributes:
        ranked: the one that the verdict names first; its hypothesis is of all readings.
        unlisted: the probability that something unlisted acts, alone or beside effects.
        beside: what acts beside the named effects; None if they are likelier alone.
        changes: by the effects of the first, where they are fitted.
    """

    ranked: tuple[Ranked, ...]
    unlisted: float
    beside: Beside | None
    changes: Changes


class _Weighed(NamedTuple):
    """A set of effects, alone or beside something unlisted, with its weight among all.

    Attributes:
        log_weight: natural logarithm of its probability but for a common constant.
        fitted: to the readings outside the extent.
        whole: the same numbers, for all readings.
        extent: of the unlisted; None without.
        problem: the readings outside the extent.
    """

    log_weight: float
    fitted: Hypothesis
    whole: Hypothesis
    extent: Extent | None
    problem: Problem

    @property
    def name(self) -> tuple[str, ...]:
        """That of its set in verdicts."""
        return self.fitted.effects or (NONE_ALONE if self.extent is None else UNKNOWN_ALONE)


def explanations(
    system: System,
    problem: Problem,
    hypotheses: Sequence[Hypothesis],
    calibration: ProbabilityCalibration,
    progress: Callable[[str, float], None] = lambda *_: None,
) -> Explanations:
    """The explanations by the hypotheses of a search, the one without effects first.

    Extents are looked for if the most probable hypothesis leaves more than it would alone.
    """
    weighed = [
        *_alone(problem, hypotheses, calibration),
        *_everywhere(problem, hypotheses, calibration),
    ]
    likeliest = posterior(hypotheses, problem.floor, calibration)[0].hypothesis
    if likeliest is None or _leaves_more(problem, likeliest, calibration):
        progress("separating what is unlisted", 0.97)
        weighed += _in_extents(system, problem, hypotheses, calibration)
    while True:
        ranked = named(problem, _merged(weighed, problem.floor), calibration)
        best = _likeliest(weighed, ranked[0].effects)
        changes = Changes(best.problem, best.fitted)
        if not best.fitted.effects or removes(changes):
            return _answer(weighed, ranked, best, changes)
        # one that removes nothing is no explanation: the others share its probability
        weighed = [each for each in weighed if each is not best]


def _leaves_more(
    problem: Problem, hypothesis: Hypothesis, calibration: ProbabilityCalibration
) -> bool:
    return probability_unlisted(hypothesis.held_out_rmse, problem.floor, calibration) >= 0.5


def _alone(
    problem: Problem, hypotheses: Sequence[Hypothesis], calibration: ProbabilityCalibration
) -> list[_Weighed]:
    """Without anything unlisted."""
    weights = log_weights_alone(hypotheses, problem.floor, calibration)
    return [
        _Weighed(float(weight), h, h, None, problem)
        for weight, h in zip(weights, hypotheses, strict=True)
    ]


def _everywhere(
    problem: Problem, hypotheses: Sequence[Hypothesis], calibration: ProbabilityCalibration
) -> list[_Weighed]:
    """Beside something unlisted that acts in all readings."""
    extent = Extent.whole(problem)
    unlisted_rmse = np.array([h.held_out_rmse for h in hypotheses])
    weights = log_weights_beside_unlisted(
        Fits.of(hypotheses),
        unlisted_rmse,
        extent.share,
        extent.log_choices,
        problem.floor,
        calibration,
    )
    return [
        _Weighed(float(weight), h, h, extent, problem)
        for weight, h in zip(weights, hypotheses, strict=True)
    ]


def _in_extents(
    system: System,
    problem: Problem,
    hypotheses: Sequence[Hypothesis],
    calibration: ProbabilityCalibration,
) -> list[_Weighed]:
    """Beside something unlisted that acts in some channels or trials."""
    screened = screened_extents(problem, system.channel_groupings())
    promising = sorted(screened, key=lambda each: -_forecast(problem, each, calibration))
    weighed: list[_Weighed] = []
    for each in promising[:_MOST_EXTENTS]:
        extent = each.extent
        others = without_extent(problem, extent)
        fitted = system.completed(others, _hypotheses(others, each, hypotheses))
        whole = [over_all_readings(problem, extent, h) for h in fitted]
        acts = extent.readings(problem)
        unlisted_rmse = np.array([_rms((problem.readings - h.held_out)[acts]) for h in whole])
        weights = log_weights_beside_unlisted(
            Fits.of(fitted),
            unlisted_rmse,
            extent.share,
            extent.log_choices,
            problem.floor,
            calibration,
        )
        weighed.extend(
            _Weighed(float(weight), one, over_all, extent, others)
            for weight, one, over_all in zip(weights, fitted, whole, strict=True)
        )
    return weighed


def _forecast(problem: Problem, screened: Screened, calibration: ProbabilityCalibration) -> float:
    """The largest weight of an explanation in an extent, linear, as if it left all there."""
    extent = screened.extent
    nominal_left = _rms((problem.readings - problem.nominal)[extent.readings(problem)])
    proposals = screened.proposals[:_MOST_PROPOSALS]
    listed_rmse = [float(np.hypot(p.forecast, problem.floor)) for p in proposals]
    fits = Fits(
        held_out_rmse=np.array([screened.without_effects.held_out_rmse, *listed_rmse]),
        effects=np.array([0, *(len(p.effects) for p in proposals)]),
        sizes=np.array([0, *(len(p.coefficients) for p in proposals)]),
        nuisance_chi2=np.zeros(1 + len(proposals)),
        nuisance_count=1,
    )
    unlisted_rmse = np.full(1 + len(proposals), nominal_left)
    weights = log_weights_beside_unlisted(
        fits, unlisted_rmse, extent.share, extent.log_choices, problem.floor, calibration
    )
    return float(weights.max())


def _merged(weighed: Sequence[_Weighed], floor: float) -> list[Ranked]:
    """Each set of effects with its probability, in the order of `in_order`."""
    probabilities = _probabilities(weighed)
    total: dict[tuple[str, ...], float] = {}
    for each, probability in zip(weighed, probabilities, strict=True):
        total[each.name] = total.get(each.name, 0.0) + probability
    ranked = []
    for name, probability in total.items():
        if name == UNKNOWN_ALONE:
            ranked.append(Ranked(name, probability, None))
        else:
            best = _likeliest(weighed, name)
            is_beside = best.extent is not None
            ranked.append(Ranked(name, probability, best.whole, remainder=is_beside))
    return in_order(ranked, floor)


def _likeliest(weighed: Sequence[_Weighed], name: tuple[str, ...]) -> _Weighed:
    """The most probable explanation by a set."""
    return max((each for each in weighed if each.name == name), key=lambda each: each.log_weight)


def _probabilities(weighed: Sequence[_Weighed]) -> list[float]:
    log_weights = np.array([each.log_weight for each in weighed])
    shares = np.exp(log_weights - log_weights.max())
    return [float(share) for share in shares / shares.sum()]


def _answer(
    weighed: Sequence[_Weighed], ranked: Sequence[Ranked], best: _Weighed, changes: Changes
) -> Explanations:
    pairs = zip(weighed, _probabilities(weighed), strict=True)
    unlisted = sum(probability for each, probability in pairs if each.extent is not None)
    beside = None
    if best.extent is not None and best.fitted.effects:
        probability_of = {each.effects: each.probability for each in ranked}
        there = [each for each in weighed if each.extent is best.extent and each is not best]
        fitted_there = [
            Ranked(each.name, probability_of[each.name], each.fitted, remainder=True)
            for each in (best, *there)
            if each.fitted.effects
        ]
        others = sorted(fitted_there[1:], key=lambda each: -each.probability)
        beside = Beside(best.extent, best.problem, (fitted_there[0], *others))
    return Explanations(tuple(ranked), unlisted, beside, changes)


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

    keep(
        chain.from_iterable(fitting.fit(problem, p) for p in screened.proposals[:_MOST_PROPOSALS])
    )
    kept = ~screened.extent.channels
    mean_square = {
        k: float(((problem.readings - h.held_out[:, kept])[problem.used] ** 2).mean())
        for k, h in enumerate(known)
        if h.effects and h.effects not in best
    }
    for k in sorted(mean_square, key=lambda k: mean_square[k])[:_MOST_KNOWN]:
        keep([fitting.refit(problem, known[k].values, _REFIT_STEPS)])
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


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))
