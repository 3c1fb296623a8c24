"""The probability of each hypothesis, and which of them a recording cannot distinguish.

The log weight of a hypothesis with k effects and n sizes is

    log w = -κ log r - τ (s / m - 1) - π_1 - (k - 1) (π_2 - π_1) - ν n - p

r is the noise-corrected RMS: that of the residual on held-out trials, beyond the sensors' floor.
s is the sum of squares of the m nuisance parameters in standard deviations, at least m; τ is below
the m / 2 of independent Gaussian ones because residuals are correlated. p is the log-prior penalty
of implausible sizes and places, where a kind of machine has one. Nuisance parameters alone have
their own power κ₀ beyond the least r that can be resolved. An unlisted effect is weighed as if the
best listed one imitated it, down to a share φ of the gap, and to γ floors if the gap is small
(docs/diagnosis_method.md):

    log w = -κ log(least) - κ₀ log(r / least) - τ (s / m - 1)                   for none
    log w = -κ log √((φ · r of none)² + (γ σ₀)²) - π_unknown                    for unknown

`benchmarks/gap_calibration.py` fits these numbers to simulated cases by their mean log
probability, so the probabilities are calibrated. Two effects are alike if one can imitate the
other's change of the readings with free numbers, and with nuisance parameters as far as
manufacturing allows.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_gap.diagnosis.linear_fit import weight
from cablesense_gap.diagnosis.problem import Hypothesis, Problem, noise_corrected_rms
from cablesense_gap.verdict import NONE, UNKNOWN

UNKNOWN_ALONE = (UNKNOWN,)
NONE_ALONE = (NONE,)
"""What the effects of a `Ranked` are that has an unlisted effect alone, and that has none."""
NEAR_BEST = 0.2
"""A rival has at least this share of the probability of the best."""

EQUAL = 0.9
"""Hypotheses with this share of the best one's probability are ordered by their residual."""

PARALLEL = 0.75
"""The shapes of two changes do not differ if one is imitated to this share."""

YIELDED = 0.5
"""The largest probability of effects that are named although an unlisted one is more probable."""
_SEVERAL_LEFT = 0.4
"""Share of the gap that three or more effects may leave to be named although an unlisted effect is
more probable."""
_AGAINST_MOTION_LEFT = 0.7
"""The same of effects of which one turns round with the motion: no static effect makes loading and
unloading differ."""
_NEEDED_COST_RATIO = 1.6
"""Leaving one of these effects out must make the cost larger by this factor."""
_RIDGE = 1e-6
"""Of the diagonal of a Gram matrix: keeps columns that are alike from an exact zero."""


@dataclass(frozen=True)
class ProbabilityCalibration:
    """The numbers of the formula above.

    `floor_share` is the noise-corrected RMS that no hypothesis can avoid, as a share of the floor.
    """

    power: float  # κ
    none: float  # κ₀
    one: float  # π_1
    two: float  # π_2
    size: float  # ν
    tolerance_chi2: float  # τ
    unknown: float  # π_unknown
    share: float  # φ
    stand_in: float  # γ
    floor_share: float


def bundled_calibration() -> ProbabilityCalibration:
    """The calibration that is installed with the package."""
    text = files("cablesense_gap.diagnosis").joinpath("calibration.json").read_text("utf-8")
    return ProbabilityCalibration(**json.loads(text))


@dataclass(frozen=True)
class Ranked:
    """A hypothesis, or an unlisted effect, with its probability.

    With a `remainder`, something unlisted acts beside the effects of the hypothesis.
    """

    effects: tuple[str, ...]
    probability: float
    hypothesis: Hypothesis | None
    remainder: bool = False


class Fits(NamedTuple):
    """What weighs of H fitted hypotheses.

    Attributes:
        held_out_rmse: (H,) RMS residual on held-out trials.
        effects: (H,) how many each has; 0 for nuisance parameters alone.
        sizes: (H,) how many of its numbers are sizes.
        nuisance_chi2: (H,) s, of the nuisance parameters.
        nuisance_count: m, of these parameters.
        log_prior_penalty: (H,) p; 0 where no size and no place is implausible.
    """

    held_out_rmse: Array
    effects: NDArray[np.int64]
    sizes: NDArray[np.int64]
    nuisance_chi2: Array
    nuisance_count: int
    log_prior_penalty: Array | float = 0.0

    @classmethod
    def of(cls, hypotheses: Sequence[Hypothesis]) -> Fits:
        """Those of hypotheses of one problem."""
        return cls(
            held_out_rmse=np.array([h.held_out_rmse for h in hypotheses]),
            effects=np.array([len(h.effects) for h in hypotheses]),
            sizes=np.array([h.sizes for h in hypotheses]),
            nuisance_chi2=np.array([h.nuisance_chi2 for h in hypotheses]),
            nuisance_count=hypotheses[0].nuisance_count,
            log_prior_penalty=np.array([h.log_prior_penalty for h in hypotheses]),
        )


def posterior(
    hypotheses: Sequence[Hypothesis], floor: float, calibration: ProbabilityCalibration
) -> list[Ranked]:
    """Probabilities of all hypotheses and of an unlisted effect, the most probable first.

    `hypotheses` contain the one of nuisance parameters alone, which is named `none`.
    """
    weights = log_weights(Fits.of(hypotheses), floor, calibration)
    shares = np.exp(weights - weights.max())
    shares /= shares.sum()
    ranked = [
        Ranked(h.effects or NONE_ALONE, float(share), h)
        for h, share in zip(hypotheses, shares, strict=False)
    ]
    ranked.append(Ranked(UNKNOWN_ALONE, float(shares[-1]), None))
    return in_order(ranked, floor)


def log_weights(fits: Fits, floor: float, calibration: ProbabilityCalibration) -> Array:
    """(H + 1,) one for each hypothesis, and the last for an unlisted effect alone.

    One of the hypotheses is that of nuisance parameters alone.
    """
    c = calibration
    least = _beyond_floor(0.0, floor, c)
    beyond_floor = np.array([_beyond_floor(rmse, floor, c) for rmse in fits.held_out_rmse])
    power = np.where(fits.effects > 0, c.power, c.none)
    listed = -power * np.log(beyond_floor / least) - _penalty(fits, c)
    nuisance_alone = beyond_floor[np.flatnonzero(fits.effects == 0)[0]]
    imitated = _stand_in(nuisance_alone, floor, c)
    return np.append(listed, -c.power * np.log(imitated / least) - c.unknown)


def log_weights_beside_unlisted(
    fits: Fits,
    unlisted_rmse: Array,
    share: float,
    log_choices: float,
    floor: float,
    calibration: ProbabilityCalibration,
) -> Array:
    """(H,) as `log_weights`, of each hypothesis with something unlisted beside it.

    The unlisted acts in a share s of the readings, chosen among C others of its kind:

        log w = -(1 - s) κ log(r / least) - s κ log(√((φ u)² + (γ σ₀)²) / least)
                - π(k) - s k κ log(1 / φ) - ν n - τ (max(s / m, 1) - 1) - p - π_unknown - log C

    r is what is left of the other readings, to which the hypothesis was fitted, and u what it
    leaves of these (`unlisted_rmse` (H,)). Each kind of reading has its own power, as a likelihood
    with an unknown variance of each has. Without effects κ₀ takes the place of κ outside. Where
    the unlisted acts, each of the k effects may be its imitation, so it must remove more than
    that does.
    """
    c = calibration
    is_listed = fits.effects > 0
    if share == 1.0:  # tolerances alone explain nothing if the unlisted acts everywhere
        fits = fits._replace(nuisance_chi2=np.where(is_listed, fits.nuisance_chi2, 0.0))
    least = _beyond_floor(0.0, floor, c)
    outside = np.array([_beyond_floor(rmse, floor, c) for rmse in fits.held_out_rmse])
    unlisted = np.array(
        [_stand_in(_beyond_floor(rmse, floor, c), floor, c) for rmse in unlisted_rmse]
    )
    power = np.where(is_listed, c.power, c.none)
    explained = (1.0 - share) * power * np.log(outside / least)
    imitated = share * fits.effects * c.power * np.log(1.0 / c.share)
    unexplained = share * c.power * np.log(unlisted / least) + imitated
    return np.asarray(-explained - unexplained - _penalty(fits, c) - c.unknown - log_choices)


def _penalty(fits: Fits, c: ProbabilityCalibration) -> Array:
    """(H,) what weighs against hypotheses beside their residuals: π(k) + ν n + τ (s/m - 1) + p."""
    of_effects = np.where(fits.effects > 0, c.one + (fits.effects - 1) * (c.two - c.one), 0.0)
    mean_square = fits.nuisance_chi2 / max(fits.nuisance_count, 1)
    strain = np.maximum(mean_square, 1.0) - 1.0
    of_numbers = c.size * fits.sizes + c.tolerance_chi2 * strain
    return np.asarray(of_effects + of_numbers + fits.log_prior_penalty)


def log_weights_alone(
    hypotheses: Sequence[Hypothesis], floor: float, calibration: ProbabilityCalibration
) -> Array:
    """(H,) as `log_weights`, of each hypothesis without anything unlisted."""
    return log_weights(Fits.of(hypotheses), floor, calibration)[:-1]


def probability_unlisted(
    held_out_rmse: float, floor: float, calibration: ProbabilityCalibration
) -> float:
    """The probability that something unlisted acts beside an explanation in some channels.

    It follows from what the explanation leaves of them: the odds of the explanation with an
    unlisted effect and without one.
    """
    c = calibration
    left = _beyond_floor(held_out_rmse, floor, c)
    log_odds = c.power * np.log(left / _stand_in(left, floor, c)) - c.unknown
    return float(1.0 / (1.0 + np.exp(-log_odds)))


def _beyond_floor(held_out_rmse: float, floor: float, c: ProbabilityCalibration) -> float:
    """What is left beyond the floor, at least what no hypothesis can avoid."""
    return float(np.hypot(noise_corrected_rms(held_out_rmse**2, floor), c.floor_share * floor))


def _stand_in(left: float, floor: float, c: ProbabilityCalibration) -> float:
    """What the best listed effects leave of an unlisted one that makes a gap of `left`."""
    return float(np.hypot(c.share * left, c.stand_in * floor))


def in_order(ranked: Sequence[Ranked], floor: float) -> list[Ranked]:
    """The most probable first; those that are about as probable by what they leave.

    Of those that leave no more than the floor, the one of fewer sizes: another that imitates it
    has just the sizes that make it do so.
    """
    least = EQUAL * max(each.probability for each in ranked)

    def rank(each: Ranked) -> tuple[float, float, int, float]:
        if each.probability <= least:
            return 1.0 - each.probability, 0.0, 0, 0.0
        if each.hypothesis is None:
            return 0.0, np.inf, 0, np.inf
        held_out_rmse = each.hypothesis.held_out_rmse
        beyond_floor = noise_corrected_rms(held_out_rmse**2, floor)
        return 0.0, beyond_floor, each.hypothesis.sizes, held_out_rmse

    return sorted(ranked, key=rank)


def named(problem: Problem, ranked: Sequence[Ranked], c: ProbabilityCalibration) -> list[Ranked]:
    """The hypotheses, first the one that the verdict names.

    This is the most probable one. An unlisted effect alone must be more probable than all
    hypotheses together that the recording cannot distinguish from the best. It also yields to a
    hypothesis that explains more than it leaves: one with several effects, or with an effect that
    depends on history or on the direction of motion. No machine equals its model, so an unlisted
    effect always acts; such a hypothesis is named with a probability of at most `YIELDED`.
    """
    first = ranked[0]
    if first.effects != UNKNOWN_ALONE:
        return list(ranked)
    together = imitating_best(problem, ranked)
    if sum(each.probability for each in together) > first.probability:
        return [together[0], *(each for each in ranked if each is not together[0])]
    fitted = {frozenset(h.effects): h for r in ranked if (h := r.hypothesis)}
    supported = [
        (problem.cost_of(each.hypothesis), k, ratios)
        for k, each in enumerate(ranked)
        if each.hypothesis and (ratios := _support(problem, fitted, each.hypothesis))
    ]
    if not supported:
        return list(ranked)
    _, k, ratios = min(supported)
    odds = c.power * np.log(list(ratios.values())) - (c.two - c.one)
    needed = float(np.prod(1.0 / (1.0 + np.exp(-odds))))
    probability = min(ranked[k].probability + needed * first.probability, YIELDED)
    moved = max(probability - ranked[k].probability, 0.0)
    chosen = replace(ranked[k], probability=ranked[k].probability + moved)
    rest = [*ranked[1:k], *ranked[k + 1 :]]
    return [chosen, *rest, replace(first, probability=first.probability - moved)]


def imitating_best(problem: Problem, ranked: Sequence[Ranked]) -> list[Ranked]:
    """The most probable hypothesis with effects, and those that it and they imitate mutually."""
    fitted = [(each, h) for each in ranked if _names_an_effect(each) and (h := each.hypothesis)]
    return [
        each
        for n, (each, h) in enumerate(fitted)
        if n == 0
        or min(imitated_share(problem, h, fitted[0][1]), imitated_share(problem, fitted[0][1], h))
        >= PARALLEL
    ]


def _support(
    problem: Problem, fitted: Mapping[frozenset[str], Hypothesis], whole: Hypothesis
) -> dict[str, float]:
    """The factor by which the cost grows without each of the effects of a hypothesis.

    Empty unless it explains more than it leaves and needs each of its effects.
    """
    candidates = problem.simulator.candidates
    past = {c.effect for c in candidates if c.history_dependent or c.against_motion}
    gap, rest = (
        noise_corrected_rms(h.held_out_rmse**2, problem.floor)
        for h in (fitted[frozenset()], whole)
    )
    whole_effects = frozenset(whole.effects)
    if whole_effects & past:
        enough = rest <= _AGAINST_MOTION_LEFT * gap
    else:
        enough = len(whole_effects) > 2 and rest <= _SEVERAL_LEFT * gap
    costs = {effects: problem.cost_of(h) for effects, h in fitted.items()}
    ratios = {
        effect: min(cost for effects, cost in costs.items() if effects <= whole_effects - {effect})
        / costs[whole_effects]
        for effect in whole.effects
    }
    needed = (
        ratio >= (1.0 / _AGAINST_MOTION_LEFT if effect in past else _NEEDED_COST_RATIO)
        for effect, ratio in ratios.items()
    )
    return ratios if enough and all(needed) else {}


class Ambiguity(NamedTuple):
    """Hypotheses between which a recording does not decide.

    Attributes:
        group: their names, the best first; several effects are joined by `+`.
        reasons: a sentence for each but the best.
    """

    group: tuple[str, ...]
    reasons: tuple[str, ...]


def ambiguity(problem: Problem, ranked: Sequence[Ranked], unit: str = "N") -> Ambiguity:
    """The hypotheses between which the recording does not decide, and a reason for each rival.

    The best comes first, and alone if it is clear; several effects are joined by `+`. `none` and
    an unlisted effect change nothing that could be compared, so they are in no group of others.
    `unit` is the unit of the channels.
    """
    best = ranked[0]
    rivals = rivals_of(ranked)
    return Ambiguity(
        group=tuple("+".join(each.effects) for each in (best, *rivals)),
        reasons=tuple(_reason(problem, best, rival, unit) for rival in rivals),
    )


def rivals_of(ranked: Sequence[Ranked]) -> tuple[Ranked, ...]:
    """Hypotheses that are not much less probable than the best, `ranked[0]`."""
    best = ranked[0]
    if not _names_an_effect(best):
        return ()
    least = NEAR_BEST * best.probability
    return tuple(r for r in ranked[1:] if r.probability >= least and _names_an_effect(r))


def near_none(ranked: Sequence[Ranked]) -> tuple[Ranked, ...]:
    """Hypotheses with effects that are not much less probable than `none`, if that is the best."""
    best = ranked[0]
    if best.hypothesis is None or best.hypothesis.effects:
        return ()
    least = NEAR_BEST * best.probability
    return tuple(r for r in ranked[1:] if r.probability >= least and _names_an_effect(r))


def _names_an_effect(ranked: Ranked) -> bool:
    return ranked.hypothesis is not None and bool(ranked.hypothesis.effects)


def imitated_share(problem: Problem, one: Hypothesis, other: Hypothesis) -> float:
    """Share of what one hypothesis changes that the other can imitate, 0 to 1.

    It is a share of the RMS of the change without its nuisance parameters; the other's numbers are
    free.
    """
    change = _beyond_nuisance(problem, _change(problem, one), one)
    whole = float(change @ change)
    if whole == 0.0:
        return 1.0
    other_changes = [_change(problem, other), *other.columns]
    columns = np.array([_beyond_nuisance(problem, column, one) for column in other_changes])
    gram = columns @ columns.T
    gram += _RIDGE * np.diag(gram.diagonal()) + np.finfo(float).tiny * np.eye(len(gram))
    moment = columns @ change
    unimitated = whole - float(moment @ np.linalg.lstsq(gram, moment, rcond=None)[0])
    return 1.0 - float(np.sqrt(np.clip(unimitated / whole, 0.0, 1.0)))


def _reason(problem: Problem, best: Ranked, rival: Ranked, unit: str) -> str:
    one = best.hypothesis
    other = rival.hypothesis
    assert one is not None
    assert other is not None
    floor = f"{problem.floor:.2g} {unit}"
    small, large = sorted((one, other), key=lambda hypothesis: len(hypothesis.effects))
    if set(small.effects) < set(large.effects):
        more = "+".join(name for name in large.effects if name not in small.effects)
        return (
            f"In addition to {'+'.join(small.effects)}, {more} reduces the residual on held-out "
            f"trials from {small.held_out_rmse:.3g} to {large.held_out_rmse:.3g} {unit}, with a "
            f"noise floor of {floor}: too little to be sure of it."
        )
    share = imitated_share(problem, one, other)
    change = _beyond_nuisance(problem, _change(problem, one), one)
    size = float(np.sqrt((change**2).sum() / (problem.used.sum() * problem.nominal.shape[1])))
    imitates = (
        f"{'+'.join(rival.effects)}, with its own numbers, imitates {100.0 * share:.0f} % of "
        f"the {size:.2g} {unit} by which {'+'.join(best.effects)} changes the readings beyond "
        "tolerances"
    )
    if share >= PARALLEL:
        return f"{imitates}: this recording cannot distinguish them."
    return (
        f"{imitates}, so they differ; but they leave {one.held_out_rmse:.2g} and "
        f"{other.held_out_rmse:.2g} {unit} on held-out trials, too near each other to choose (the "
        f"noise floor is {floor})."
    )


def _change(problem: Problem, hypothesis: Hypothesis) -> Array:
    """(R, C) the change by the effects with their fitted numbers."""
    fitted = problem.coefficients_of(hypothesis.nuisance)
    of_nuisance = np.tensordot(fitted, problem.nuisance_columns, axes=1)
    known = problem.nominal + problem.nuisance_remainder
    return np.asarray(hypothesis.prediction - of_nuisance - known)


def _beyond_nuisance(problem: Problem, change: Array, fitted: Hypothesis) -> Array:
    """The part of a change over the used rows, flat, that nuisance parameters do not imitate.

    The cost of their priors is appended, so that products of two such vectors are those of the
    marginal likelihood of the readings.
    """
    weight_ = weight(fitted.held_out_rmse**2, problem.floor)
    nuisance = problem.nuisance_columns[:, problem.used]
    flat = nuisance.reshape(len(nuisance), int(problem.used.sum()) * change.shape[1])
    target = change[problem.used].ravel()
    coefficients = np.linalg.solve(flat @ flat.T + np.eye(len(flat)) / weight_, flat @ target)
    return np.concatenate([target - coefficients @ flat, coefficients / np.sqrt(weight_)])
