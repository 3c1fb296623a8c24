"""The content of a hypothesis: shares of the gap, the unexplained part, sizes, estimates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_gap.diagnosis.probability import NEAR_BEST, Ranked
from cablesense_gap.diagnosis.problem import Hypothesis, Problem, from_scaled, to_scaled
from cablesense_gap.simulator import Candidate, Term, parameters_of
from cablesense_gap.verdict import (
    CandidateResult,
    FittedNumber,
    Gap,
    Share,
    Traded,
    removed_fraction,
)
from cablesense_sim.effects.effect import WHOLE_ARM, Parameter

TRADING = 0.8
"""Correlation of two fitted shares, in size, from which on they trade against each other."""
NEGLIGIBLE = 0.1
"""A place that changes the readings by less than this share of the largest one is not named."""
_LEFT_AT_MOST = 0.9
"""Share of the gap that named effects may leave on held-out trials: what removes less than a tenth
says nothing about the machine that someone could act on."""
_UNSURE = 0.1
"""Relative standard deviation of a share below which the share is known and trades with none."""
_DRAWS = 2000
"""Of a bootstrap: the quantiles of an interval are then good to a few per cent of its width."""


class Trade(NamedTuple):
    """Two effects of one hypothesis whose sum the recording shows better than the parts.

    Attributes:
        traded: for the verdict.
        elsewhere: numbers of the hypothesis that are as probable as the fitted ones, with the
            smaller of the two effects reduced by 1.96 standard deviations.
    """

    traded: Traded
    elsewhere: dict[Term, float]


class Remainder(NamedTuple):
    """The residual parts beyond the effects of a hypothesis, RMS in the channels' unit.

    Attributes:
        tolerances: by which fitted tolerances change predictions.
        unexplained: beyond the floor, on held-out trials.
        share: ratio of `unexplained` to the nominal gap beyond the floor.
    """

    tolerances: float
    unexplained: float
    share: float


def significant_values(
    hypothesis: Hypothesis, candidates: Sequence[Candidate]
) -> dict[Term, float]:
    """The values in the places that matter, effect by effect."""
    parameters = parameters_of(candidates)
    changes: dict[tuple[str, str], float] = {}
    for column, (term, value) in zip(hypothesis.columns, hypothesis.values.items(), strict=True):
        if parameters[term].role == "size":
            size = _rms(column) * abs(to_scaled(parameters[term], value))
            changes[term[:2]] = float(np.hypot(changes.get(term[:2], 0.0), size))
    largest = {
        effect: max(size for (name, _), size in changes.items() if name == effect)
        for effect in hypothesis.effects
    }
    return {
        term: value
        for term, value in hypothesis.values.items()
        if changes[term[:2]] >= NEGLIGIBLE * largest[term.effect]
    }


def estimates(
    values: Mapping[Term, float], deviations: Mapping[Term, float], candidates: Sequence[Candidate]
) -> dict[str, FittedNumber]:
    """Values with units, and their intervals, clipped to the plausible range.

    The name contains the place if there is more than one place.
    """
    parameters = parameters_of(candidates)
    single = len({term[:2] for term in values}) == 1
    return {
        f"{term.effect}.{term.parameter}" if single else str(term): fitted_number(
            parameters[term], value, deviations[term]
        )
        for term, value in values.items()
    }


def fitted_number(parameter: Parameter, value: float, half: float) -> FittedNumber:
    """A value with its interval of this half width, within the plausible range."""
    low = max(value - half, parameter.low)
    high = min(value + half, parameter.high)
    return FittedNumber(value=value, unit=parameter.unit, ci95=(low, high))


class Changes:
    """By how much a hypothesis's predictions change without some of its effects.

    Each change is simulated once, when it is first asked for.

    Attributes:
        problem: the readings that the hypothesis is fitted to.
        hypothesis: all of whose other numbers stay as fitted.
    """

    def __init__(self, problem: Problem, hypothesis: Hypothesis) -> None:
        """Take a hypothesis of a problem."""
        self.problem = problem
        self.hypothesis = hypothesis
        self._simulated: dict[frozenset[str], Array] = {}

    def without(self, *effects: str) -> Array:
        """(R, C) predictions with all effects minus those without these."""
        named = frozenset(effects)
        if named not in self._simulated:
            values = self.hypothesis.values
            others = {term: value for term, value in values.items() if term.effect not in named}
            (predicted,) = self.problem.predict([others])
            self._simulated[named] = self.hypothesis.without_nuisance - predicted
        return self._simulated[named]


def shares(
    changes: Changes, ranked: Sequence[Ranked], values: Mapping[Term, float]
) -> dict[str, Share]:
    """The share of each effect of a hypothesis, the first of those `ranked`, the largest first.

    `values` are those in the places that matter. The intervals are linear about the fit.
    """
    problem = changes.problem
    best = changes.hypothesis
    contributions = {effect: _contribution(changes, effect) for effect in best.effects}
    largest = sorted(best.effects, key=lambda effect: -contributions[effect].size)
    share_of = {}
    for k, effect in enumerate(largest):
        included = {t: v for t, v in best.values.items() if t.effect in largest[: k + 1]}
        last = k + 1 == len(largest)
        predicted = best.held_out_effects if last else problem.predict([included])[0]
        places = dict.fromkeys(t.place for t in values if t.effect == effect)
        share_of[effect] = Share(
            share_n=contributions[effect].size,
            ci95_n=contributions[effect].interval,
            left_n=_rms((problem.readings - predicted)[problem.used]),
            probability=min(1.0, sum(r.probability for r in ranked if effect in r.effects)),
            places=tuple(p for p in places if p != WHOLE_ARM),
            alternatives=_alternatives(ranked, effect),
        )
    return share_of


def removes(changes: Changes) -> bool:
    """Whether the effects of a hypothesis make predictions better, and each of them changes them.

    On held-out trials they leave less than `_LEFT_AT_MOST` of the gap of the nominal machine. The
    share of each effect is larger than its own standard deviation, or that of a pair is in which
    it trades with another.
    """
    problem = changes.problem
    hypothesis = changes.hypothesis
    before = _rms((problem.readings - problem.nominal)[problem.used])
    if hypothesis.held_out_rmse >= _LEFT_AT_MOST * before:
        return False
    pairs = trades(changes)
    in_known_pairs = {
        effect
        for trade in pairs
        if trade.traded.ci95_n[0] > 0.0
        for effect in trade.traded.effects
    }
    contributions = {effect: _contribution(changes, effect) for effect in hypothesis.effects}
    known_alone = {effect for effect, part in contributions.items() if part.size > part.deviation}
    return set(hypothesis.effects) <= known_alone | in_known_pairs


def remainder(problem: Problem, hypothesis: Hypothesis) -> Remainder:
    """The contribution of tolerances and the unexplained part."""
    used = problem.used
    floor = problem.floor
    gap = _rms((problem.readings - problem.nominal)[used])
    unexplained, whole = (
        float(np.sqrt(max(size**2 - floor**2, 0.0))) for size in (hypothesis.held_out_rmse, gap)
    )
    tolerances = _rms((hypothesis.prediction - hypothesis.without_nuisance)[used])
    share = min(1.0, unexplained / whole) if whole > 0.0 else 0.0
    return Remainder(tolerances, unexplained, share)


def trades(changes: Changes) -> list[Trade]:
    """Pairs of effects whose shares trade against each other, the largest pair first.

    The sensitivities at the fit decide: numbers of both can move together so that predictions
    hardly change. Sizes that need opposite signs for that are such a pair too.
    """
    problem = changes.problem
    best = changes.hypothesis
    contributions = {effect: _contribution(changes, effect) for effect in best.effects}
    traded_pairs = []
    for pair in combinations(best.effects, 2):
        one, other = (contributions[effect] for effect in pair)
        if any(part.deviation <= _UNSURE * part.size for part in (one, other)):
            continue
        covariance = float(one.slope @ best.covariance @ other.slope)
        correlation = covariance / (one.deviation * other.deviation)
        if abs(correlation) < TRADING:
            continue
        joint_contribution = _contribution(changes, *pair)
        less = min(one, other, key=lambda part: part.size)
        traded = Traded(
            effects=pair,
            share_n=joint_contribution.size,
            ci95_n=joint_contribution.interval,
            correlation=float(np.clip(correlation, -1.0, 1.0)),
        )
        step = -1.96 * (best.covariance @ less.slope) / less.deviation
        elsewhere = {
            term: from_scaled(problem.parameters[term], scaled_value)
            for term, scaled_value in zip(best.values, _scaled(problem, best) + step, strict=True)
        }
        traded_pairs.append(Trade(traded, elsewhere))
    return sorted(traded_pairs, key=lambda trade: -trade.traded.share_n)


def _scaled(problem: Problem, fitted: Hypothesis) -> Array:
    """(K,) the fitted numbers in the units of the fit."""
    return np.array([to_scaled(problem.parameters[t], v) for t, v in fitted.values.items()])


class _Contribution(NamedTuple):
    """RMS by which some effects change predictions, its standard deviation and its slope.

    `slope` (K,) is the derivative by the scaled numbers of these effects, zero for others.
    """

    size: float
    deviation: float
    slope: Array

    @property
    def interval(self) -> tuple[float, float]:
        half = 1.96 * self.deviation
        return max(self.size - half, 0.0), self.size + half


def _contribution(changes: Changes, *effects: str) -> _Contribution:
    problem = changes.problem
    best = changes.hypothesis
    change = changes.without(*effects)[problem.used]
    size = _rms(change)
    slope = np.zeros(len(best.values))
    if size > 0.0:
        by_number = (best.columns[:, problem.used] * change).mean(axis=(1, 2)) / size
        slope = np.where([term.effect in effects for term in best.values], by_number, 0.0)
    return _Contribution(size, max(float(slope @ best.covariance @ slope), 0.0) ** 0.5, slope)


def _alternatives(ranked: Sequence[Ranked], effect: str) -> tuple[str, ...]:
    """Effects that replace it in hypotheses that are otherwise equal and nearly as probable."""
    best = ranked[0]
    others = set(best.effects) - {effect}
    return tuple(
        sorted(
            name
            for each in ranked[1:]
            if len(each.effects) == len(best.effects)
            and others < set(each.effects)
            and each.probability >= NEAR_BEST * best.probability
            for name in set(each.effects) - others
        )
    )


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))


def candidate_results(ranked: Sequence[Ranked]) -> tuple[CandidateResult, ...]:
    """Every hypothesis with its residual; an unlisted effect has that of tolerances alone."""
    without_effects = next(
        r.hypothesis for r in ranked if r.hypothesis and not r.hypothesis.effects
    )
    return tuple(
        CandidateResult(
            effects=each.effects,
            unlisted=each.remainder,
            held_out_rmse_n=h.held_out_rmse,
            probability=each.probability,
            held_out_ci95_n=rmse_interval_n(h.squares, h.count),
        )
        for each in ranked
        for h in (each.hypothesis or without_effects,)
    )


def gap_size(
    before_n: Array,
    after_n: Array,
    trial: NDArray[np.int64],
    floor_n: float,
    effects_n: Array | None = None,
) -> Gap:
    """Sizes of residuals (R, C) before and after, with a bootstrap over trials (R,).

    `effects_n` (R, C) is the residual with the effects alone, without tolerances.
    """
    trial = np.unique(trial, return_inverse=True)[1]  # a draw of empty trials has no size
    squares = [np.bincount(trial, (each**2).sum(-1)).astype(float) for each in (before_n, after_n)]
    count = np.bincount(trial).astype(float) * before_n.shape[1]
    drawn = zip(*(_bootstrapped_rms(each, count) for each in squares), strict=True)
    fractions = [removed_fraction(before, after, floor_n) for before, after in drawn]
    low, high = np.quantile(fractions, [0.025, 0.975])
    before, after = (float(np.sqrt(each.sum() / count.sum())) for each in squares)
    return Gap(
        before_n=before,
        after_n=after,
        floor_n=floor_n,
        removed_fraction=removed_fraction(before, after, floor_n),
        ci95=(float(low), float(high)),
        by_cable_n=tuple(float(v) for v in np.sqrt((before_n**2).mean(0))),
        effects_n=None if effects_n is None else float(np.sqrt((effects_n**2).mean())),
    )


def rmse_interval_n(squares: Array, count: Array) -> tuple[float, float]:
    """95 % interval of the root mean square of squares (T,) of trials, by bootstrap over them."""
    sizes = _bootstrapped_rms(squares[count > 0], count[count > 0])
    low, high = np.quantile(sizes, [0.025, 0.975])
    return float(low), float(high)


def _bootstrapped_rms(squares: Array, count: Array) -> Array:
    """(draws,) root mean squares of trials (T,) drawn with replacement, the same at each call.

    `scipy.stats.bootstrap` takes samples of one statistic; these are ratios of two sums.
    """
    drawn = np.random.default_rng(0).integers(0, len(count), (_DRAWS, len(count)))
    return np.asarray(np.sqrt(squares[drawn].sum(-1) / count[drawn].sum(-1)))
