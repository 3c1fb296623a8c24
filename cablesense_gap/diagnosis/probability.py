"""How probable each explanation is, and which of them a recording cannot distinguish.

The weights fall with a power of what is left beyond the sensors' floor on held-out trials, and by
a factor for every effect that an explanation names:

    log w = -κ log(excess) - τ log(s / m) - π_1 - (k - 1) (π_2 - π_1) - ν n,

for k effects of n sizes in all,

with s the sum of squares of the m tolerances in standard deviations, taken as m where it is less:
manufacturing tolerances should not have to be many deviations off,

for tolerances alone, which are out where the gap is plain, with a power κ₀ of its own,

    log w = -κ log(least) - κ₀ log(excess / least) - τ log(s / m),    least = what can be resolved,

and an unlisted effect is weighed as if the best listed one imitated it, which leaves
a share φ of the gap, and γ floors where the gap is small:

    log w = -κ log √((φ · excess of none)² + (γ σ₀)²) - π_unknown

The few numbers are fitted to simulated cases (`benchmarks/gap_calibration.py`) by their mean log
probability, so that the probabilities are calibrated.

Two effects are alike where one can imitate what the other changes in the readings: its numbers
are free, and tolerances may help as far as manufacturing leaves them.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.resources import files

import numpy as np

from cablesense_base import Array
from cablesense_gap.diagnosis.evidence import weight
from cablesense_gap.diagnosis.problem import Explanation, Problem, excess

UNKNOWN = ("unknown",)
LEAST, NEAR_BEST = 0.1, 0.2
"""A rival has at least this probability, and this share of that of the best."""
PARALLEL = 0.75
"""What can be imitated to this share is not distinguished by its shape."""
_SLIGHT = 1e-6
_SEVERAL = 3
_UNEXPLAINED, _OUTWEIGHED = 0.4, 0.7
"""Share of the gap that may stay beside several effects, and beside one that depends on history or
turns round with the motion: no static effect makes loading and unloading differ, so what it
explains, none imitates."""
_BORNE_OUT = 1.6
"""A named effect's part must be about as large as all that stays unexplained."""


@dataclass(frozen=True)
class ProbabilityCalibration:
    """The numbers of the formula above.

    Attributes:
        power: κ.
        none: κ₀.
        one: π_1.
        two: π_2.
        size: ν.
        tolerance_chi2: τ.
        unknown: π_unknown.
        share: φ.
        stand_in: γ.
        floor_share: excess that no explanation can do without, as a share of the floor.
    """

    power: float
    none: float
    one: float
    two: float
    size: float
    tolerance_chi2: float
    unknown: float
    share: float
    stand_in: float
    floor_share: float


def bundled_calibration() -> ProbabilityCalibration:
    """That of `calibration.json` beside this file."""
    text = files("cablesense_gap.diagnosis").joinpath("calibration.json").read_text("utf-8")
    return ProbabilityCalibration(**json.loads(text))


@dataclass(frozen=True)
class Ranked:
    """An explanation, or that of an unlisted effect, with its probability."""

    effects: tuple[str, ...]
    probability: float
    explanation: Explanation | None


def posterior(
    explanations: Sequence[Explanation], floor: float, calibration: ProbabilityCalibration
) -> list[Ranked]:
    """Probabilities of all explanations and of an unlisted effect, the most probable first.

    `explanations` holds that of tolerances alone, which stands for `none`.
    """
    weights = log_weights(
        np.array([h.held_out_rmse for h in explanations]),
        np.array([len(h.effects) for h in explanations]),
        np.array([h.sizes for h in explanations]),
        np.array([h.tolerance_chi2 for h in explanations]),
        max(len(explanations[0].tolerances), 1),
        floor,
        calibration,
    )
    shares = np.exp(weights - weights.max())
    shares /= shares.sum()
    found = [
        Ranked(h.effects or ("none",), float(share), h)
        for h, share in zip(explanations, shares, strict=False)
    ]
    found.append(Ranked(UNKNOWN, float(shares[-1]), None))
    return sorted(found, key=lambda ranked: -ranked.probability)


def named(problem: Problem, ranked: Sequence[Ranked], c: ProbabilityCalibration) -> list[Ranked]:
    """The explanations, first the one that the verdict names.

    The most probable one, unless that is an unlisted effect although listed ones are borne out,
    several, or one that depends on history or turns round with the motion, that explain more than
    they leave. Then it is the one of them that leaves least, and what it leaves is unexplained and
    stated beside it.
    """
    first = ranked[0]
    if first.effects != UNKNOWN:
        return list(ranked)
    borne_out = [
        (problem.cost_of(each.explanation), k, ratios)
        for k, each in enumerate(ranked)
        if each.explanation
        and (ratios := _left_out_ratios(problem, ranked, each.explanation))
        and _outweighs(problem, ranked, ratios, each)
    ]
    if not borne_out:
        return list(ranked)
    _, k, ratios = min(borne_out)
    odds = c.power * np.log(list(ratios.values())) - (c.two - c.one)
    exact = float(np.prod(1.0 / (1.0 + np.exp(-odds)))) * first.probability
    chosen = replace(ranked[k], probability=ranked[k].probability + exact)
    rest = [*ranked[1:k], *ranked[k + 1 :]]
    return [chosen, *rest, replace(first, probability=first.probability - exact)]


def _outweighs(
    problem: Problem, ranked: Sequence[Ranked], ratios: dict[str, float], one: Ranked
) -> bool:
    """Whether an explanation explains more than it leaves, and needs each of its effects."""
    left = {r.effects: r.explanation for r in ranked if r.explanation}
    gap, rest = (
        excess(left[effects].held_out_rmse ** 2, problem.floor)
        for effects in (("none",), one.effects)
    )
    candidates = problem.simulator.candidates
    past = {c.effect for c in candidates if c.history_dependent or c.against_motion}
    if past.isdisjoint(ratios):
        enough = len(ratios) >= _SEVERAL and rest <= _UNEXPLAINED * gap
    else:
        enough = rest <= _OUTWEIGHED * gap
    least = {effect: 1.0 / _OUTWEIGHED if effect in past else _BORNE_OUT for effect in ratios}
    return enough and all(ratio >= least[effect] for effect, ratio in ratios.items())


def _left_out_ratios(
    problem: Problem, ranked: Sequence[Ranked], whole: Explanation
) -> dict[str, float]:
    """By which factor what is left grows without each of the effects."""
    costs = [(set(h.effects), problem.cost_of(h)) for r in ranked if (h := r.explanation)]
    own = set(whole.effects)
    return {
        effect: min(cost for effects, cost in costs if effects <= own - {effect})
        / problem.cost_of(whole)
        for effect in whole.effects
    }


def log_weights(
    held_out_rmse: Array,
    counts: np.ndarray,
    sizes: np.ndarray,
    tolerance_chi2: Array,
    tolerance_count: float,
    floor: float,
    calibration: ProbabilityCalibration,
) -> Array:
    """Of each explanation, and last of an unlisted effect; `counts` 0 marks tolerances alone."""
    c = calibration
    floor_share = c.floor_share * floor
    left = np.array([np.hypot(excess(e**2, floor), floor_share) for e in held_out_rmse])
    least = np.hypot(excess(0.0, floor), floor_share)
    none = left[np.flatnonzero(counts == 0)[0]]
    power = np.where(counts == 0, c.none, c.power)
    several = c.one + (counts - 1) * (c.two - c.one)
    penalty = np.where(counts == 0, 0.0, several) + c.size * sizes
    penalty += c.tolerance_chi2 * np.log(np.maximum(tolerance_chi2 / tolerance_count, 1.0))
    stand_in = np.hypot(c.share * none, c.stand_in * floor)
    unknown = -c.power * np.log(stand_in / least) - c.unknown
    return np.append(-power * np.log(left / least) - penalty, unknown)


def ambiguity(
    problem: Problem, ranked: Sequence[Ranked], unit: str = "N"
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Explanations between which the recording does not decide, and a reason for each rival.

    The best comes first, and alone where it is clear; several effects are joined by `+`. `none`
    and an unlisted effect change nothing that could be compared: they stand alone, and are in
    nobody's group. `unit` is that of the channels.
    """
    best, rivals = ranked[0], rivals_of(ranked)
    return (
        tuple("+".join(each.effects) for each in (best, *rivals)),
        tuple(_reason(problem, best, rival, unit) for rival in rivals),
    )


def rivals_of(ranked: Sequence[Ranked]) -> tuple[Ranked, ...]:
    """Explanations too probable to be dismissed beside the best, which is `ranked[0]`."""
    best = ranked[0]
    if not _names_an_effect(best):
        return ()
    least = max(LEAST, NEAR_BEST * best.probability)
    return tuple(r for r in ranked[1:] if r.probability >= least and _names_an_effect(r))


def _names_an_effect(ranked: Ranked) -> bool:
    return ranked.explanation is not None and bool(ranked.explanation.effects)


def imitated_share(problem: Problem, one: Explanation, other: Explanation) -> float:
    """Share of what one explanation changes that the other can imitate, 0 to 1.

    Of the root mean square of the change, tolerances taken out; the other's numbers are free.
    """
    change = _beyond_tolerances(problem, _change(problem, one), one)
    whole = float(change @ change)
    if whole == 0.0:
        return 1.0
    own = [_change(problem, other), *other.columns]
    columns = np.array([_beyond_tolerances(problem, column, one) for column in own])
    gram = columns @ columns.T
    gram += _SLIGHT * np.diag(gram.diagonal()) + np.finfo(float).tiny * np.eye(len(gram))
    moment = columns @ change
    left = whole - float(moment @ np.linalg.lstsq(gram, moment, rcond=None)[0])
    return 1.0 - float(np.sqrt(np.clip(left / whole, 0.0, 1.0)))


def _reason(problem: Problem, best: Ranked, rival: Ranked, unit: str) -> str:
    one, other = best.explanation, rival.explanation
    assert one is not None
    assert other is not None
    small, large = sorted((one, other), key=lambda explanation: len(explanation.effects))
    if set(small.effects) < set(large.effects):
        more = "+".join(name for name in large.effects if name not in small.effects)
        return (
            f"Beside {'+'.join(small.effects)}, {more} takes what is left on trials that the fit "
            f"has not seen from {small.held_out_rmse:.3g} to {large.held_out_rmse:.3g} {unit}, "
            f"with a noise floor of {problem.floor:.2g} {unit}: too little to be sure that it is "
            "there."
        )
    share = imitated_share(problem, one, other)
    change = _beyond_tolerances(problem, _change(problem, one), one)
    size = float(np.sqrt((change**2).sum() / (problem.used.sum() * problem.nominal.shape[1])))
    imitates = (
        f"{'+'.join(rival.effects)}, with numbers of its own, imitates {100.0 * share:.0f} % of "
        f"the {size:.2g} {unit} by which {'+'.join(best.effects)} changes the readings beyond "
        "tolerances"
    )
    if share >= PARALLEL:
        return f"{imitates}: this recording shows both alike."
    return (
        f"{imitates}, so they differ; yet they leave {one.held_out_rmse:.2g} and "
        f"{other.held_out_rmse:.2g} {unit} on trials that they have not seen, too near each other "
        f"to choose (the noise floor is {problem.floor:.2g} {unit})."
    )


def _change(problem: Problem, explanation: Explanation) -> Array:
    """(R, C) what the effects change, at their fitted numbers."""
    scaled = [
        explanation.tolerances.get(term, 0.0) / std
        for term, std in zip(problem.tolerance_terms, problem.tolerance_std, strict=True)
    ]
    of_tolerances = np.tensordot(np.array(scaled), problem.tolerance_columns, axes=1)
    return np.asarray(explanation.prediction - of_tolerances - problem.nominal)


def _beyond_tolerances(problem: Problem, change: Array, fitted: Explanation) -> Array:
    """Over the used rows, flat: what tolerances leave of a change, at the cost of their priors.

    The priors' cost is part of the vector, so that the products of two of them are those of the
    readings' marginal likelihood.
    """
    weight_ = weight(fitted.held_out_rmse**2, problem.floor)
    tolerances = problem.tolerance_columns[:, problem.used]
    flat = tolerances.reshape(len(tolerances), int(problem.used.sum()) * change.shape[1])
    target = change[problem.used].ravel()
    found = np.linalg.solve(flat @ flat.T + np.eye(len(flat)) / weight_, flat @ target)
    return np.concatenate([target - found @ flat, found / np.sqrt(weight_)])
