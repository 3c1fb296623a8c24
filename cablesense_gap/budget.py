"""The budget of a gap: the share of each effect, of tolerances and sensors, and what is left."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_gap.diagnosis.probability import NEAR_BEST, Ranked
from cablesense_gap.diagnosis.problem import Hypothesis, Problem
from cablesense_gap.simulator import Term
from cablesense_gap.verdict import Share
from cablesense_sim.effects.effect import WHOLE_ARM


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
    best = ranked[0].hypothesis
    if best is None:
        return {}
    changes = {}
    for effect in best.effects:
        others = {t: v for t, v in best.values.items() if t.effect != effect}
        changes[effect] = best.without_tolerances - problem.simulator.predict([others])[0]
    largest = sorted(best.effects, key=lambda effect: -_rms(changes[effect][problem.used]))
    found = {}
    for k, effect in enumerate(largest):
        own = np.flatnonzero([t.effect == effect for t in best.values])
        share, deviation = _share(problem, changes[effect], best, own)
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


def rest_of(problem: Problem, hypothesis: Hypothesis) -> Rest:
    """What remains beside the effects of an explanation."""
    used, floor = problem.used, problem.floor
    gap = _rms((problem.readings - problem.nominal)[used])
    unexplained, whole = (
        float(np.sqrt(max(size**2 - floor**2, 0.0))) for size in (hypothesis.held_out_rmse, gap)
    )
    tolerances = _rms((hypothesis.prediction - hypothesis.without_tolerances)[used])
    return Rest(tolerances, unexplained, min(1.0, unexplained / whole) if whole > 0.0 else 0.0)


def _share(
    problem: Problem, change: Array, hypothesis: Hypothesis, own: NDArray[np.int64]
) -> tuple[float, float]:
    """Root mean square of a change, and its standard deviation."""
    size = _rms(change[problem.used])
    if size == 0.0:
        return 0.0, 0.0
    columns = hypothesis.columns[own][:, problem.used]
    slope = (columns * change[problem.used]).mean(axis=(1, 2)) / size
    return size, float(np.sqrt(slope @ hypothesis.covariance[np.ix_(own, own)] @ slope))


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
