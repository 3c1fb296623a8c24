"""The budget of a gap: the share of each effect, of tolerances and sensors, and what is left."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_gap.diagnosis.probability import NEAR_BEST, Ranked
from cablesense_gap.diagnosis.problem import Explanation, Problem, from_scaled, to_scaled
from cablesense_gap.simulator import Term, parameters_of
from cablesense_gap.verdict import Share, Traded
from cablesense_sim.effects.effect import WHOLE_ARM

TRADING = 0.8
"""Size of the correlation of two shares, as fitted, from which on they trade."""
_UNSURE = 0.1
"""Standard deviation of a share, of the share itself, below which nothing is left to trade."""


class Trade(NamedTuple):
    """Two effects of one explanation, of which the recording shows the sum better than the parts.

    Attributes:
        traded: for the verdict.
        elsewhere: numbers of the explanation as probable as those fitted, with less of the
            smaller one of the two by 1.96 standard deviations.
    """

    traded: Traded
    elsewhere: dict[Term, float]


class Rest(NamedTuple):
    """What effects do not account for, RMS in the channels' unit.

    Attributes:
        tolerances: by how much they change predictions, as fitted.
        unexplained: beyond the floor, on trials that the fit has not seen.
        share: of `unexplained` in the nominal mechanism's gap beyond the floor.
    """

    tolerances: float
    unexplained: float
    share: float


def shares(
    problem: Problem, ranked: Sequence[Ranked], values: Mapping[Term, float]
) -> dict[str, Share]:
    """Of each effect of the first explanation, the largest first.

    `values` are those in places that matter. The interval is that of the effect's numbers, linear
    about them.
    """
    best = ranked[0].explanation
    if best is None:
        return {}
    changes = {effect: _change(problem, best, {effect}) for effect in best.effects}
    largest = sorted(best.effects, key=lambda effect: -_rms(changes[effect][problem.used]))
    found = {}
    for k, effect in enumerate(largest):
        share, deviation = _share(problem, changes[effect], best, {effect})
        places = dict.fromkeys(t.place for t in values if t.effect == effect)
        so_far = {t: v for t, v in best.values.items() if t.effect in largest[: k + 1]}
        every = k + 1 == len(largest)
        left = problem.readings - (
            best.held_out_effects if every else problem.simulator.predict([so_far])[0]
        )
        found[effect] = Share(
            share_n=share,
            ci95_n=(max(share - 1.96 * deviation, 0.0), share + 1.96 * deviation),
            left_n=_rms(left[problem.used]),
            probability=min(1.0, sum(r.probability for r in ranked if effect in r.effects)),
            places=tuple(p for p in places if p != WHOLE_ARM),
            alternatives=_alternatives(ranked, effect),
        )
    return found


def rest_of(problem: Problem, explanation: Explanation) -> Rest:
    """What remains beside the effects of an explanation."""
    used, floor = problem.used, problem.floor
    gap = _rms((problem.readings - problem.nominal)[used])
    unexplained, whole = (
        float(np.sqrt(max(size**2 - floor**2, 0.0))) for size in (explanation.held_out_rmse, gap)
    )
    tolerances = _rms((explanation.prediction - explanation.without_tolerances)[used])
    return Rest(tolerances, unexplained, min(1.0, unexplained / whole) if whole > 0.0 else 0.0)


def trades(problem: Problem, best: Explanation) -> list[Trade]:
    """Pairs of effects whose shares trade against each other, the largest pair first.

    By the sensitivities at the fit: numbers of both may move together so that predictions hardly
    change. Sizes that would have to be of opposite sign are such a pair too.
    """
    changes = {effect: _change(problem, best, {effect}) for effect in best.effects}
    slopes = {effect: _slope(problem, changes[effect], best, {effect}) for effect in best.effects}
    found = []
    for pair in combinations(best.effects, 2):
        moved = [best.covariance @ slopes[effect] for effect in pair]
        stds = [
            max(float(slopes[effect] @ move), 0.0) ** 0.5
            for effect, move in zip(pair, moved, strict=True)
        ]
        sizes = [_rms(changes[effect][problem.used]) for effect in pair]
        if any(std <= _UNSURE * size for std, size in zip(stds, sizes, strict=True)):
            continue
        correlation = float(slopes[pair[0]] @ moved[1]) / (stds[0] * stds[1])
        if abs(correlation) < TRADING:
            continue
        share, deviation = _share(problem, _change(problem, best, set(pair)), best, set(pair))
        traded = Traded(
            effects=pair,
            share_n=share,
            ci95_n=(max(share - 1.96 * deviation, 0.0), share + 1.96 * deviation),
            correlation=float(np.clip(correlation, -1.0, 1.0)),
        )
        less = int(np.argmin(sizes))
        found.append(Trade(traded, _elsewhere(problem, best, -1.96 * moved[less] / stds[less])))
    return sorted(found, key=lambda trade: -trade.traded.share_n)


def _elsewhere(problem: Problem, best: Explanation, scaled: Array) -> dict[Term, float]:
    known = parameters_of(problem.simulator.candidates)
    return {
        term: from_scaled(known[term], to_scaled(known[term], value) + float(step))
        for (term, value), step in zip(best.values.items(), scaled, strict=True)
    }


def _change(problem: Problem, best: Explanation, effects: set[str]) -> Array:
    """(R, C) by which predictions change without some effects, all else as fitted."""
    others = {t: v for t, v in best.values.items() if t.effect not in effects}
    return np.asarray(best.without_tolerances - problem.simulator.predict([others])[0])


def _share(
    problem: Problem, change: Array, best: Explanation, effects: set[str]
) -> tuple[float, float]:
    """Root mean square of a change, and its standard deviation."""
    slope = _slope(problem, change, best, effects)
    variance = float(slope @ best.covariance @ slope)
    return _rms(change[problem.used]), max(variance, 0.0) ** 0.5


def _slope(problem: Problem, change: Array, best: Explanation, effects: set[str]) -> Array:
    """(K,) of a change's root mean square, by the scaled numbers of the effects that make it."""
    size = _rms(change[problem.used])
    own = np.array([term.effect in effects for term in best.values])
    if size == 0.0:
        return np.zeros(len(own))
    by = (best.columns[:, problem.used] * change[problem.used]).mean(axis=(1, 2))
    return np.asarray(np.where(own, by / size, 0.0))


def _alternatives(ranked: Sequence[Ranked], effect: str) -> tuple[str, ...]:
    """Effects in whose place it might stand: all others alike, and nearly as probable."""
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
