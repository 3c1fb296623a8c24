"""The pipeline from a system with its recording to a verdict, for arms, robots and others.

The steps are the search (`diagnosis.search`), probabilities (`diagnosis.probability`), then
shares, places, estimates and the gap (`explained`). A `System` has a method for each step that
depends on the kind of machine.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from cablesense_base import Array
from cablesense_gap.by_channel import acting_channels, judged_channels
from cablesense_gap.coverage import Coverage
from cablesense_gap.diagnosis.duration import expected_s
from cablesense_gap.diagnosis.nuisance_posterior import NuisancePosterior, nuisance_posterior
from cablesense_gap.diagnosis.probability import (
    UNKNOWN,
    Ranked,
    ambiguity,
    bundled_calibration,
    near_none,
    rivals_of,
)
from cablesense_gap.diagnosis.problem import Hypothesis, Problem
from cablesense_gap.diagnosis.search import search
from cablesense_gap.explained import (
    candidate_results,
    gap_size,
    remainder,
    shares,
    significant_values,
    trades,
)
from cablesense_gap.explanations import Beside, explanations
from cablesense_gap.kept_simulations import KeptSimulations
from cablesense_gap.reference import Expected, Reference, expected_of_inexact_model, problem_since
from cablesense_gap.simulator import Term
from cablesense_gap.system import System, problem_of
from cablesense_gap.verdict import (
    CANNOT_TELL,
    NONE,
    ChannelGap,
    Gap,
    ReferenceGap,
    UnlistedBeside,
    Verdict,
)

DOUBTED = 0.5
"""The largest probability of a verdict that its numbers, or a reference that hardly covers the
recording, make doubtful."""
_MUCH_UNEXPLAINED = 0.25
"""Share of the gap from which the next experiment is to show most of the unexplained part."""


@dataclass(frozen=True)
class Outcome:
    """A verdict and the fit behind it.

    Attributes:
        values: of the named effects in the places that matter.
        tolerances: as fitted.
        known: the tolerances with their covariance.
        nominal: (R, C) predicted by the nominal machine.
        held_out: (R, C) by the amended machine, or with the flexible correction; each trial with
            effects, or a correction, without its fold.
    """

    verdict: Verdict
    values: dict[Term, float]
    tolerances: Mapping[Term, float]
    known: NuisancePosterior
    nominal: Array
    held_out: Array


def _cannot_tell(coverage: Coverage, ranked: Sequence[Ranked]) -> bool:
    """Whether the reference leaves open if something changed.

    A channel of which most is not covered may have changed unseen. Named effects rest on the
    covered readings: they stand if these make them probable, in more than one trial.
    """
    if not coverage.lacking:
        return False
    best = ranked[0]
    if best.hypothesis is None or not best.hypothesis.effects or coverage.share == 0.0:
        return True
    without_effects = next(h for r in ranked if (h := r.hypothesis) and not h.effects)
    return best.probability <= DOUBTED or not best.hypothesis.is_clearly_better_than(
        without_effects
    )


def _changed_where_covered(first: Ranked) -> tuple[str, ...]:
    if first.effects != UNKNOWN:
        return ()
    return (
        "Where the reference covers the recording, something changed that no listed effect "
        "explains.",
    )


def _reference_gap(reference: Reference, coverage: Coverage | None) -> ReferenceGap:
    if coverage is None:
        return reference.left
    stated_coverage = {"covered_share": coverage.share, "coverage": dict(coverage.by_channel)}
    return reference.left.model_copy(update=stated_coverage)


def diagnose_system(
    system: System,
    progress: Callable[[str, float], None] = lambda *_: None,
    workers: int = 1,
    began_s: float | None = None,
    reference: Reference | None = None,
    announce: Callable[[float], None] = lambda _: None,
    kept: KeptSimulations | None = None,
) -> Outcome:
    """Find what makes the recorded machine differ from the nominal one.

    `progress` receives the present step and the share that is done, in the stages of
    `diagnosis.duration`; `announce` receives the seconds that it will take, before the search;
    `began_s` is when the diagnosis started, by `time.monotonic`. With a `reference`, whose known
    values the system has, it is what changed since then. What is simulated is `kept` in files if
    given, and taken from there if it is there already.
    """
    began_s = time.monotonic() if began_s is None else began_s
    progress("preparing", 0.0)
    prepares_s = time.monotonic()
    problem = problem_of(system, kept)
    prepared_s = time.monotonic() - prepares_s
    if kept is None or not kept.count:  # what is kept takes no time
        announce(expected_s(problem, prepared_s, workers))
    calibration = bundled_calibration()
    nothing = np.zeros_like(problem.readings)
    usual = Expected(nothing, nothing + 1.0, problem.floor)
    if reference is not None:
        usual = reference.expected(system, problem)
        problem = problem_since(problem, usual)
    hypotheses = system.completed(problem, search(problem, progress, workers))
    weighed = partial(explanations, system, calibration=calibration, progress=progress)
    explained_by = weighed(problem, hypotheses)
    error = None if reference is not None else system.model_error(problem, hypotheses)
    if error is not None:
        beside = explained_by.beside
        if beside is not None and beside.nothing_elsewhere(calibration):
            error = None
    if error is not None:
        usual = expected_of_inexact_model(system, problem, error, hypotheses)
        problem = problem_since(problem, usual)
        hypotheses = system.completed(problem, search(problem, progress, workers))
        explained_by = weighed(problem, hypotheses)
    ranked = list(explained_by.ranked)
    beside = explained_by.beside
    coverage = usual.coverage
    cannot_tell = coverage is not None and _cannot_tell(coverage, ranked)
    changed: tuple[str, ...] = ()
    if cannot_tell:
        changed = _changed_where_covered(ranked[0])
        ranked = sorted(ranked, key=lambda each: each.effects != (NONE,))
        beside = None
    # the readings in which nothing unlisted acts, and the hypotheses that were fitted to these
    of_effects = problem
    fitted_to_these = ranked
    if beside is not None:
        of_effects = beside.problem
        fitted_to_these = list(beside.ranked)
    progress("describing the verdict", 0.98)
    best = ranked[0].hypothesis
    used = problem.used
    without_effects = next(h for h in hypotheses if not h.effects)
    explained = best or without_effects
    values = significant_values(explained, system.candidates)
    fitted = fitted_to_these[0].hypothesis
    traded = trades(of_effects, fitted) if fitted else []
    rest = remainder(problem, explained)
    group, reasons = ambiguity(of_effects, fitted_to_these, system.unit)
    held_out = explained.held_out
    experiment = ""
    if best:
        near = rivals_of(fitted_to_these) or near_none(fitted_to_these)
        rivals = [r.hypothesis.values for r in near if r.hypothesis is not None]
        if traded and not rivals:
            one, other = (e.replace("_", " ") for e in traded[0].traded.effects)
            question = f"how much is {one} and how much {other}"
            experiment = system.next_experiment([best.values, traded[0].elsewhere], question)
        elif beside is not None:
            described = system.unlisted(problem, problem.readings - best.held_out)
            reasons = (*reasons, *described.reasons)
            experiment = "" if rivals else described.experiment
        elif rest.share >= _MUCH_UNEXPLAINED and not rivals:
            experiment = system.repetition((system.readings - usual.read(best.held_out))[used])
        experiment = experiment or system.next_experiment([values, *rivals], "")
    else:
        described = system.unlisted(problem, problem.readings - without_effects.held_out)
        least = min(hypotheses, key=lambda e: e.held_out_rmse)
        names = " with ".join(least.effects).replace("_", " ") or "none"
        comparison = (
            "On held-out trials, tolerances alone leave "
            f"{without_effects.held_out_rmse:.3g} {system.unit}; "
            f"the best that listed effects do is {least.held_out_rmse:.3g} {system.unit} "
            f"({names})."
        )
        reasons = (comparison, *described.reasons)
        experiment = described.experiment
        held_out = without_effects.held_out + described.correction
    predicted = held_out if beside is None or fitted is None else fitted.held_out
    gap = _gap_of(of_effects, predicted, fitted)
    nominal, held_out = (usual.read(each) for each in (problem.nominal, held_out))
    measured = [system.readings - each for each in (nominal, held_out)]
    numbers = system.numbers(explained, values)
    if reference is not None:
        numbers = reference.widened(numbers, values)
    doubts = system.doubts(values, gap) if values else ()
    if error is not None:
        inexact = (
            "No explanation fits any channel. As models of real machines do, this one is taken to "
            f"leave {np.sqrt((error**2).mean()):.3g} {system.unit}, most of them a function of a "
            "channel's position and direction. The verdict names an effect that exceeds this "
            "error. A reference, recorded when the machine was healthy, would show more.",
        )
        doubts, reasons = (inexact + doubts, reasons) if values else (doubts, inexact + reasons)
    if doubts:
        sure = min(ranked[0].probability, DOUBTED)
        ranked = [replace(ranked[0], probability=sure), *ranked[1:]]
    stated = [replace(fitted_to_these[0], probability=ranked[0].probability), *ranked[1:]]
    rows = of_effects.used
    deviations = _rms((usual.floor / usual.weight)[rows])
    gaps = system.channels(measured[0][rows], measured[1][rows], deviations)
    channels = judged_channels(replace(problem, used=rows), explained, gaps, calibration)
    effects = ranked[0].effects
    probability = ranked[0].probability
    if cannot_tell and coverage is not None:
        effects = (CANNOT_TELL,)
        group = effects
        probability = 1.0 - min(channel.share for channel in coverage.by_channel.values())
        experiment = coverage.experiment
        reasons = changed
    verdict = Verdict(
        effects=effects,
        probability=probability,
        ambiguity_group=group,
        next_experiment=experiment,
        where=system.where(values, measured[0][used]),
        parameters=numbers,
        shares=shares(of_effects, stated, values),
        traded=tuple(trade.traded for trade in traded),
        forms=system.forms(problem, best) if best else {},
        tolerances_n=rest.tolerances,
        unlisted=_unlisted(system, problem, ranked, explained_by.unlisted, beside, channels),
        unexplained_n=rest.unexplained,
        unexplained_share=rest.share,
        gap=gap,
        doubts=doubts,
        reference=None if reference is None else _reference_gap(reference, coverage),
        candidates=candidate_results(stated),
        why=reasons,
        seconds=time.monotonic() - began_s,
        recording=system.recording_name,
        rows=system.row_count,
        rows_used=len(problem.trial),
        rows_counted=int(used.sum()),
        arm=system.name,
        unit=system.unit,
        channels=channels,
        compared=system.compared,
    )
    progress("done", 1.0)
    known = nuisance_posterior(of_effects, fitted or explained)
    return Outcome(verdict, values, explained.nuisance, known, nominal, held_out)


def _gap_of(problem: Problem, held_out: Array, explained: Hypothesis | None) -> Gap:
    """The gap before and after, predicted as (R, C), and of effects without tolerances."""
    used = problem.used
    before = (problem.readings - problem.nominal)[used]
    after = (problem.readings - held_out)[used]
    alone = None
    if explained is not None and explained.effects:
        alone = (problem.readings - explained.held_out_effects)[used]
    return gap_size(before, after, problem.trial[used], problem.floor, alone)


def _unlisted(
    system: System,
    problem: Problem,
    ranked: Sequence[Ranked],
    probability: float,
    beside: Beside | None,
    channels: Mapping[str, ChannelGap],
) -> UnlistedBeside | None:
    """What acts beside the named effects; None where no effect is named."""
    explained = ranked[0].hypothesis
    if explained is None or not explained.effects:
        return None
    acting = acting_channels(channels)
    if beside is None:
        if not acting:
            return None
        in_one = max(gap.unlisted or 0.0 for gap in channels.values())
        return UnlistedBeside(probability=max(probability, in_one), channels=acting)
    acts = beside.extent.readings(problem)
    residuals = (problem.readings - each for each in (problem.nominal, explained.held_out))
    before_n, after_n = (float(np.sqrt((each[acts] ** 2).mean())) for each in residuals)
    return UnlistedBeside(
        probability=probability,
        channels=acting,
        trials=system.trial_labels(beside.extent.trials.nonzero()[0].tolist()),
        before_n=before_n,
        after_n=after_n,
    )


def _rms(values: Array) -> Array:
    return np.asarray(np.sqrt((values**2).mean(0)))
