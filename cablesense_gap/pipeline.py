"""The pipeline from a system with its recording to a verdict, for arms, robots and others.

The steps are the search (`diagnosis.search`), probabilities (`diagnosis.probability`), then
shares, places, estimates and the gap (`explained`). A `System` has a method for each step that
depends on the kind of machine.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cablesense_base import Array
from cablesense_gap.by_channel import acting_channels, judged_channels
from cablesense_gap.coverage import Coverage
from cablesense_gap.diagnosis.duration import expected_s
from cablesense_gap.diagnosis.nuisance_posterior import NuisancePosterior, nuisance_posterior
from cablesense_gap.diagnosis.probability import (
    UNKNOWN_ALONE,
    ProbabilityCalibration,
    Ranked,
    ambiguity,
    bundled_calibration,
    near_none,
    rivals_of,
)
from cablesense_gap.diagnosis.problem import Hypothesis, Problem
from cablesense_gap.diagnosis.search import search
from cablesense_gap.explained import (
    Changes,
    Remainder,
    Trade,
    candidate_results,
    gap_size,
    remainder,
    shares,
    significant_values,
    trades,
)
from cablesense_gap.explanations import Beside, Explanations, explanations
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

DOUBTFUL_VERDICT = 0.5
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


@dataclass(frozen=True)
class _Weighing:
    """All explanations of a recording, by what is expected of the nominal machine.

    Attributes:
        expected: of the machine beyond its model: of the healthy one by a reference, or of one
            whose model has an error.
        model_error: (C,) RMS that the nominal model is taken to leave; None if it is exact, and
            against a reference.
        problem: the readings beyond the expected ones.
        hypotheses: of the search in it.
        explanations: by these, weighed.
        calibration: by which they are weighed.
    """

    expected: Expected
    model_error: Array | None
    problem: Problem
    hypotheses: list[Hypothesis]
    explanations: Explanations
    calibration: ProbabilityCalibration


@dataclass(frozen=True)
class _Naming:
    """The explanation that the verdict names, and the readings that it rests on.

    Attributes:
        ranked: all that is weighed, the named one first.
        insufficient: the coverage by a reference that leaves open if something changed, so that
            the verdict cannot tell; None if it does not, and without a reference.
        beside: something unlisted that acts beside the named effects; None if nothing does.
        problem: the readings in which nothing unlisted acts.
        ranked_there: the hypotheses that were fitted to these, the named one first.
        whole: the named hypothesis for all readings, that of tolerances alone where none is named.
        changes: by its effects, as it is fitted in `problem`.
        values: of `whole` in the places that matter.
    """

    ranked: list[Ranked]
    insufficient: Coverage | None
    beside: Beside | None
    problem: Problem
    ranked_there: list[Ranked]
    whole: Hypothesis
    changes: Changes
    values: dict[Term, float]

    @property
    def hypothesis(self) -> Hypothesis | None:
        """The named one for all readings; None if an unlisted effect is named."""
        return self.ranked[0].hypothesis

    @property
    def fitted(self) -> Hypothesis | None:
        """The same, as it was fitted to the readings in which nothing unlisted acts."""
        return self.ranked_there[0].hypothesis

    def doubted(self, doubts: Sequence[str]) -> _Naming:
        """The same with a probability that doubts bound."""
        if not doubts:
            return self
        first = replace(
            self.ranked[0], probability=min(self.ranked[0].probability, DOUBTFUL_VERDICT)
        )
        return replace(self, ranked=[first, *self.ranked[1:]])

    @property
    def stated(self) -> list[Ranked]:
        """All that is weighed, the named one as it was fitted."""
        first = replace(self.ranked_there[0], probability=self.ranked[0].probability)
        return [first, *self.ranked[1:]]


@dataclass(frozen=True)
class _Account:
    """What a person reads about the named explanation.

    Attributes:
        group: the explanations between which the recording does not decide.
        reasons: why it is named, as sentences.
        experiment: what to record next.
        traded: its effects whose shares trade against each other.
        remainder: beyond its effects.
        held_out: (R, C) of the weighted problem by it, or with the flexible correction.
    """

    group: tuple[str, ...]
    reasons: tuple[str, ...]
    experiment: str
    traded: list[Trade]
    remainder: Remainder
    held_out: Array


@dataclass(frozen=True)
class _Comparison:
    """Readings as measured, as the nominal and as the amended machine predict them.

    Attributes:
        nominal: (R, C) predicted by the nominal machine.
        held_out: (R, C) by the amended one, or with the flexible correction.
        residual: (R, C) of the nominal machine.
        gap: over the readings in which nothing unlisted acts.
        channels: the same by channel, with what removes it.
    """

    nominal: Array
    held_out: Array
    residual: Array
    gap: Gap
    channels: dict[str, ChannelGap]


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
    weighing = _weighing(system, problem, reference, progress, workers)
    naming = _naming(system, weighing)
    progress("describing the verdict", 0.98)
    account = _account(system, weighing, naming)
    comparison = _comparison(system, weighing, naming, account)
    verdict = _verdict(system, reference, weighing, naming, account, comparison)
    progress("done", 1.0)
    return Outcome(
        verdict=verdict.model_copy(update={"seconds": time.monotonic() - began_s}),
        values=naming.values,
        tolerances=naming.whole.nuisance,
        known=nuisance_posterior(naming.problem, naming.fitted or naming.whole),
        nominal=comparison.nominal,
        held_out=comparison.held_out,
    )


def _weighing(
    system: System,
    problem: Problem,
    reference: Reference | None,
    progress: Callable[[str, float], None],
    workers: int,
) -> _Weighing:
    """The explanations of a recording.

    Without a reference they are weighed again if no hypothesis fits any channel: the model is
    then taken to have an error, as models of real machines do.
    """
    calibration = bundled_calibration()

    def weighed(expected: Expected, error: Array | None, expecting: Problem) -> _Weighing:
        hypotheses = system.completed(expecting, search(expecting, progress, workers))
        explained = explanations(system, expecting, hypotheses, calibration, progress)
        return _Weighing(expected, error, expecting, hypotheses, explained, calibration)

    if reference is not None:
        healthy = reference.expected(system, problem)
        return weighed(healthy, None, problem_since(problem, healthy))
    nothing = np.zeros_like(problem.readings)
    exact = weighed(Expected(nothing, nothing + 1.0, problem.floor), None, problem)
    error = system.model_error(problem, exact.hypotheses)
    beside = exact.explanations.beside
    if error is None or (beside is not None and beside.nothing_elsewhere(calibration)):
        return exact
    inexact = expected_of_inexact_model(system, problem, error, exact.hypotheses)
    return weighed(inexact, error, problem_since(problem, inexact))


def _naming(system: System, weighing: _Weighing) -> _Naming:
    """The likeliest explanation; none of a change where a reference leaves that open."""
    ranked = list(weighing.explanations.ranked)
    beside = weighing.explanations.beside
    coverage = weighing.expected.coverage
    insufficient = None
    if coverage is not None and _cannot_tell(coverage, ranked):
        insufficient = coverage
        ranked = sorted(ranked, key=lambda each: each.effects != (NONE,))
        beside = None
    problem = weighing.problem if beside is None else beside.problem
    ranked_there = ranked if beside is None else list(beside.ranked)
    whole = ranked[0].hypothesis or _without_effects(weighing.hypotheses)
    changes = weighing.explanations.changes
    if changes.hypothesis is not ranked_there[0].hypothesis:
        changes = Changes(problem, whole)
    return _Naming(
        ranked=ranked,
        insufficient=insufficient,
        beside=beside,
        problem=problem,
        ranked_there=ranked_there,
        whole=whole,
        changes=changes,
        values=significant_values(whole, system.candidates),
    )


def _cannot_tell(coverage: Coverage, ranked: Sequence[Ranked]) -> bool:
    """Whether the reference leaves open if something changed.

    A channel of which most is not covered (`uncovered_channels`) may have changed unseen. Named
    effects rest on the covered readings: they stand if these make them probable, in more than one
    trial.
    """
    if not coverage.uncovered_channels:
        return False
    best = ranked[0]
    if best.hypothesis is None or not best.hypothesis.effects or coverage.share == 0.0:
        return True
    without_effects = _without_effects([h for r in ranked if (h := r.hypothesis)])
    return best.probability <= DOUBTFUL_VERDICT or not best.hypothesis.is_clearly_better_than(
        without_effects
    )


def _without_effects(hypotheses: Sequence[Hypothesis]) -> Hypothesis:
    """The hypothesis of tolerances alone."""
    return next(hypothesis for hypothesis in hypotheses if not hypothesis.effects)


def _account(system: System, weighing: _Weighing, naming: _Naming) -> _Account:
    """What a person reads about the named explanation, and what to record next."""
    undecided = ambiguity(naming.problem, naming.ranked_there, system.unit)
    account = _Account(
        group=undecided.group,
        reasons=undecided.reasons,
        experiment="",
        traded=trades(naming.changes),
        remainder=remainder(weighing.problem, naming.whole),
        held_out=naming.whole.held_out,
    )
    if naming.hypothesis is None:
        account = _of_unlisted(system, weighing, account)
    else:
        account = _of_hypothesis(system, weighing, naming, naming.hypothesis, account)
    if naming.insufficient is None:
        return account
    return replace(
        account,
        group=(CANNOT_TELL,),
        reasons=_changed_where_covered(weighing.explanations.ranked[0]),
        experiment=naming.insufficient.experiment,
    )


def _of_hypothesis(
    system: System, weighing: _Weighing, naming: _Naming, named: Hypothesis, account: _Account
) -> _Account:
    """With the experiment for a named hypothesis: it asks for what is least known of it."""
    problem = weighing.problem
    near = rivals_of(naming.ranked_there) or near_none(naming.ranked_there)
    rivals = [r.hypothesis.values for r in near if r.hypothesis is not None]
    reasons = account.reasons
    experiment = ""
    if account.traded and not rivals:
        foremost = account.traded[0]
        one, other = (effect.replace("_", " ") for effect in foremost.traded.effects)
        question = f"how much is {one} and how much {other}"
        experiment = system.next_experiment([named.values, foremost.elsewhere], question)
    elif naming.beside is not None:
        described = system.unlisted(problem, problem.readings - named.held_out)
        reasons = (*reasons, *described.reasons)
        experiment = "" if rivals else described.experiment
    elif account.remainder.share >= _MUCH_UNEXPLAINED and not rivals:
        residual = system.readings - weighing.expected.read(named.held_out)
        experiment = system.repetition(residual[problem.used])
    experiment = experiment or system.next_experiment([naming.values, *rivals], "")
    return replace(account, reasons=reasons, experiment=experiment)


def _of_unlisted(system: System, weighing: _Weighing, account: _Account) -> _Account:
    """With the pattern of what an unlisted effect leaves, and a correction without physics."""
    problem = weighing.problem
    without_effects = _without_effects(weighing.hypotheses)
    described = system.unlisted(problem, problem.readings - without_effects.held_out)
    least = min(weighing.hypotheses, key=lambda each: each.held_out_rmse)
    names = " with ".join(least.effects).replace("_", " ") or "none"
    comparison = (
        "On held-out trials, tolerances alone leave "
        f"{without_effects.held_out_rmse:.3g} {system.unit}; "
        f"the best that listed effects do is {least.held_out_rmse:.3g} {system.unit} "
        f"({names})."
    )
    return replace(
        account,
        reasons=(comparison, *described.reasons),
        experiment=described.experiment,
        held_out=without_effects.held_out + described.correction,
    )


def _changed_where_covered(likeliest: Ranked) -> tuple[str, ...]:
    """What is still to be said where a reference leaves open if something changed."""
    if likeliest.effects != UNKNOWN_ALONE:
        return ()
    return (
        "Where the reference covers the recording, something changed that no listed effect "
        "explains.",
    )


def _comparison(
    system: System, weighing: _Weighing, naming: _Naming, account: _Account
) -> _Comparison:
    """The gap before and after, of the readings in which nothing unlisted acts."""
    expected = weighing.expected
    fitted = naming.fitted
    held_out_there = account.held_out
    if naming.beside is not None and fitted is not None:
        held_out_there = fitted.held_out
    nominal = expected.read(weighing.problem.nominal)
    held_out = expected.read(account.held_out)
    residual = system.readings - nominal
    residual_after = system.readings - held_out
    rows = naming.problem.used
    deviations = _rms((expected.floor / expected.weight)[rows])
    gaps = system.channels(residual[rows], residual_after[rows], deviations)
    changes = naming.changes
    if naming.beside is not None:
        changes = Changes(weighing.problem, naming.whole)
    return _Comparison(
        nominal=nominal,
        held_out=held_out,
        residual=residual,
        gap=_gap_of(naming.problem, held_out_there, fitted),
        channels=judged_channels(changes, rows, gaps, weighing.calibration),
    )


def _verdict(
    system: System,
    reference: Reference | None,
    weighing: _Weighing,
    naming: _Naming,
    account: _Account,
    comparison: _Comparison,
) -> Verdict:
    """The verdict, but for the time that it took."""
    problem = weighing.problem
    values = naming.values
    named = naming.hypothesis
    numbers = system.numbers(naming.whole, values)
    if reference is not None:
        numbers = reference.widened(numbers, values)
    inexact = _inexact(system, weighing)
    doubts = (*inexact, *system.doubts(values, comparison.gap)) if values else ()
    naming = naming.doubted(doubts)
    effects = naming.ranked[0].effects
    probability = naming.ranked[0].probability
    if naming.insufficient is not None:
        effects = (CANNOT_TELL,)
        probability = 1.0 - min(each.share for each in naming.insufficient.by_channel.values())
    return Verdict(
        effects=effects,
        probability=probability,
        ambiguity_group=account.group,
        next_experiment=account.experiment,
        where=system.where(values, comparison.residual[problem.used]),
        parameters=numbers,
        shares=shares(naming.changes, naming.stated, values),
        traded=tuple(trade.traded for trade in account.traded),
        forms=system.forms(problem, named) if named else {},
        tolerances_n=account.remainder.tolerances,
        unlisted=_unlisted(system, weighing, naming, comparison.channels),
        unexplained_n=account.remainder.unexplained,
        unexplained_share=account.remainder.share,
        gap=comparison.gap,
        doubts=doubts,
        reference=_reference_gap(reference, weighing.expected.coverage),
        candidates=candidate_results(naming.stated),
        why=account.reasons if values else (*inexact, *account.reasons),
        recording=system.recording_name,
        rows=system.recorded_row_count,
        rows_used=len(problem.trial),
        rows_counted=int(problem.used.sum()),
        arm=system.name,
        unit=system.unit,
        channels=comparison.channels,
        compared=system.compared,
    )


def _inexact(system: System, weighing: _Weighing) -> tuple[str, ...]:
    """A sentence where the nominal model is taken to have an error."""
    if weighing.model_error is None:
        return ()
    error = np.sqrt((weighing.model_error**2).mean())
    return (
        "No explanation fits any channel. As models of real machines do, this one is taken to "
        f"leave {error:.3g} {system.unit}, most of them a function of a "
        "channel's position and direction. The verdict names an effect that exceeds this "
        "error. A reference, recorded when the machine was healthy, would show more.",
    )


def _reference_gap(reference: Reference | None, coverage: Coverage | None) -> ReferenceGap | None:
    """The gap of a reference, and how much of the recording it covers."""
    if reference is None:
        return None
    if coverage is None:
        return reference.left
    stated_coverage = {"covered_share": coverage.share, "coverage": dict(coverage.by_channel)}
    return reference.left.model_copy(update=stated_coverage)


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
    system: System, weighing: _Weighing, naming: _Naming, channels: Mapping[str, ChannelGap]
) -> UnlistedBeside | None:
    """What acts beside the named effects; None where no effect is named."""
    named = naming.hypothesis
    if named is None or not named.effects:
        return None
    problem = weighing.problem
    probability = weighing.explanations.unlisted
    acting = acting_channels(channels)
    beside = naming.beside
    if beside is None:
        if not acting:
            return None
        in_one = max(gap.unlisted or 0.0 for gap in channels.values())
        return UnlistedBeside(probability=max(probability, in_one), channels=acting)
    acts = beside.extent.readings(problem)
    residuals = (problem.readings - each for each in (problem.nominal, named.held_out))
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
