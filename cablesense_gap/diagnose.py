"""From a recording and a nominal arm to a verdict.

Which trials of a recording are held out together.

How large the gap is before and after, and how sure that is.

Places and numbers of the effects found, as the verdict names them.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablesense_base.arrays import Array
from cablesense_gap.arm_simulator import ArmSimulator, amended_arm, has_one_equilibrium
from cablesense_gap.diagnosis.probability import (
    Ranked,
    ambiguity,
    bundled_calibration,
    posterior,
    rivals_of,
)
from cablesense_gap.diagnosis.problem import Hypothesis, Problem, prepare, to_scaled
from cablesense_gap.diagnosis.search import search
from cablesense_gap.experiments import next_experiment
from cablesense_gap.recordings.checks import check_recording
from cablesense_gap.recordings.recording import Recording
from cablesense_gap.residuals import decompose, regimes
from cablesense_gap.simulator import Candidate, Term
from cablesense_gap.unlisted import describe_unlisted
from cablesense_gap.verdict import CandidateResult, Estimate, Gap, Verdict, Where, removed_fraction
from cablesense_sim.arm import Arm
from cablesense_sim.replay import replay_arm

FOLDS = 5


def folds_of(recording: Recording) -> NDArray[np.int64]:
    """(T,) fold 0 to 4 of each trial, in the order of their numbers.

    Trials of one kind, by the segment that is loaded and by whether the arm moves, are dealt
    to the folds in turn, so that each fold leaves some of every kind to fit to.
    """
    kinds: dict[tuple[int, bool], list[int]] = {}
    for t, number in enumerate(np.unique(recording.trial)):
        rows = recording.trial == number
        moves = bool((np.ptp(recording.command_rad[rows], axis=0) > 0.0).any())
        kinds.setdefault((int(recording.load_segment[rows].max()), moves), []).append(t)
    dealt = [t for kind in sorted(kinds) for t in kinds[kind]]
    fold = np.empty(len(dealt), dtype=np.int64)
    fold[dealt] = np.arange(len(dealt)) % min(FOLDS, len(dealt))
    return fold


_DRAWS = 2000


def gap_size(before_n: Array, after_n: Array, trial: NDArray[np.int64], floor_n: float) -> Gap:
    """Sizes over residuals (R, M) before and after, with a bootstrap over trials (R,).

    The floor is that of the sensors; what a workshop leaves is in the amended arm's own file.
    """
    trial = np.unique(trial, return_inverse=True)[1]  # a draw of empty trials has no size
    per_trial = [np.bincount(trial, (residual**2).sum(-1)) for residual in (before_n, after_n)]
    count = np.bincount(trial) * before_n.shape[1]
    rng = np.random.default_rng(0)
    drawn = rng.integers(0, len(count), (_DRAWS, len(count)))
    numbers = count[drawn].sum(-1)
    sizes = [np.sqrt(squares[drawn].sum(-1) / numbers) for squares in per_trial]
    fractions = [
        removed_fraction(before, after, floor_n) for before, after in zip(*sizes, strict=True)
    ]
    low, high = np.quantile(fractions, [0.025, 0.975])
    whole_before, whole_after = (
        float(np.sqrt(squares.sum() / count.sum())) for squares in per_trial
    )
    return Gap(
        before_n=whole_before,
        after_n=whole_after,
        floor_n=floor_n,
        removed_fraction=removed_fraction(whole_before, whole_after, floor_n),
        ci95=(float(low), float(high)),
        by_cable_n=tuple(float(v) for v in np.sqrt((before_n**2).mean(0))),
    )


def rmse_interval_n(squares: Array, count: Array) -> tuple[float, float]:
    """95 % interval of the root mean square of squares (T,) of trials, by bootstrap over them."""
    squares, count = squares[count > 0], count[count > 0]
    rng = np.random.default_rng(0)
    drawn = rng.integers(0, len(count), (_DRAWS, len(count)))
    sizes = np.sqrt(squares[drawn].sum(-1) / count[drawn].sum(-1))
    low, high = np.quantile(sizes, [0.025, 0.975])
    return float(low), float(high)


NEGLIGIBLE = 0.1
"""A place that changes the readings by less than this share of the foremost one is not named."""


def foremost(hypothesis: Hypothesis, candidates: tuple[Candidate, ...]) -> dict[Term, float]:
    """The values in those places that matter, effect by effect."""
    parameters = {(c.effect, p.name): p for c in candidates for p in c.parameters}
    changes: dict[tuple[str, str], float] = {}
    for column, (term, value) in zip(hypothesis.columns, hypothesis.values.items(), strict=True):
        parameter = parameters[term.effect, term.parameter]
        if parameter.role == "size":
            size = float(np.sqrt((column**2).mean())) * abs(to_scaled(parameter, value))
            key = term.effect, term.place
            changes[key] = float(np.hypot(changes.get(key, 0.0), size))
    largest = {
        effect: max(size for (name, _), size in changes.items() if name == effect)
        for effect in hypothesis.effects
    }
    return {
        term: value
        for term, value in hypothesis.values.items()
        if changes[term.effect, term.place] >= NEGLIGIBLE * largest[term.effect]
    }


def where(values: Mapping[Term, float], regimes: tuple[str, ...]) -> Where:
    """The places by kind; an effect of the whole arm names none."""
    named: dict[str, set[int]] = {"cable": set(), "segment": set(), "joint": set()}
    for term in values:
        place = term.place.split("_into_")[0]  # of a leak, the channel that it comes from
        for kind, number in re.findall(r"(cable|segment|joint)_(\d+)", place):
            named[kind].add(int(number))
    listed = {
        kind: tuple(f"{kind}_{n}" for n in sorted(numbers)) for kind, numbers in named.items()
    }
    return Where(
        cables=listed["cable"],
        segments=listed["segment"],
        joints=listed["joint"],
        regimes=regimes,
    )


def estimates(
    values: Mapping[Term, float],
    deviations: Mapping[Term, float],
    candidates: tuple[Candidate, ...],
) -> dict[str, Estimate]:
    """Numbers with units, and intervals within what is plausible.

    The place is in the name where there are several, of one effect or of two.
    """
    known = {(c.effect, p.name): p for c in candidates for p in c.parameters}
    single = len({(term.effect, term.place) for term in values}) == 1
    found = {}
    for term, value in values.items():
        parameter, half = known[term.effect, term.parameter], deviations[term]
        found[f"{term.effect}.{term.parameter}" if single else str(term)] = Estimate(
            value=value,
            unit=parameter.unit,
            ci95=(max(value - half, parameter.low), min(value + half, parameter.high)),
        )
    return found


@dataclass(frozen=True)
class Diagnosis:
    """A verdict, the arm that follows from it, and what both arms predict.

    Attributes:
        verdict: as it is written to `verdict.json`.
        amended: the arm with what was found.
        predicted_before_n: (R, M) by the nominal arm.
        predicted_after_n: (R, M) by the amended arm.
        held_out_n: (R, M) by the amended arm, each trial fitted without its fold.
        findings: what the checks of the recording found.
    """

    verdict: Verdict
    amended: Arm
    predicted_before_n: Array
    predicted_after_n: Array
    held_out_n: Array
    findings: tuple[str, ...]


def diagnose(
    recording: Recording,
    arm: Arm,
    progress: Callable[[str, float], None] = lambda *_: None,
    workers: int = 1,
) -> Diagnosis:
    """Tell what makes the recorded arm differ from the nominal one.

    `tell` hears what is under way and which share of it is behind.

    Raises:
        RecordingError: the recording cannot be used.
        EquilibriumError: the nominal arm finds no rest under its commands and loads.
    """
    began = time.monotonic()
    check_recording(recording, arm).raise_if_unusable()
    progress("predicting the nominal arm", 0.0)
    simulator = ArmSimulator(arm, recording)
    nominal = _nominal(simulator, recording, arm)
    checked = check_recording(recording, arm, nominal)
    checked.raise_if_unusable()
    problem = problem_of(recording, simulator, nominal)
    ranked = posterior(search(problem, progress, workers), problem.floor, bundled_calibration())
    progress("what it means", 0.98)
    none = next(b.hypothesis for b in ranked if b.effects == ("none",))
    assert none is not None
    found = ranked[0].hypothesis
    explained = found or none
    values = foremost(explained, tuple(simulator.candidates))
    fitted = [b.hypothesis for b in ranked if b.hypothesis is not None]
    unlisted = None if found else describe_unlisted(problem, recording, fitted, arm)
    held_out = explained.held_out if unlisted is None else unlisted.held_out_n
    used = problem.used
    before = recording.tensions_n - nominal
    regimes_ = tuple(regimes(decompose(recording.rows(used), before[used], problem.floor, arm)))
    group = ambiguity(problem, ranked)
    rivals = [b.hypothesis.values for b in rivals_of(ranked) if b.hypothesis is not None]
    verdict = Verdict(
        effects=ranked[0].effects,
        probability=ranked[0].probability,
        ambiguity_group=group.group,
        next_experiment=next_experiment(arm, [values, *rivals], problem.floor).text
        if unlisted is None
        else unlisted.next_experiment,
        where=where(values, regimes_),
        parameters=estimates(values, explained.deviations, tuple(simulator.candidates)),
        gap=gap_size(
            before[used],
            (recording.tensions_n - held_out)[used],
            problem.trial[used],
            problem.floor,
        ),
        candidates=tuple(_candidate(ranked, none) for ranked in ranked),
        why=group.reasons if unlisted is None else unlisted.reasons,
        seconds=time.monotonic() - began,
        recording=recording.name,
        arm=arm.name,
    )
    progress("done", 1.0)
    return Diagnosis(
        verdict=verdict,
        amended=amended_arm(arm, values, explained.tolerances),
        predicted_before_n=nominal,
        predicted_after_n=explained.prediction if unlisted is None else held_out,
        held_out_n=held_out,
        findings=tuple(finding.text for finding in checked.findings),
    )


def _nominal(simulator: ArmSimulator, recording: Recording, arm: Arm) -> Array:
    nominal = simulator.predict([{}])[0]
    if not np.isfinite(nominal).all():
        return replay_arm(arm, recording.time_s, recording.command_rad, recording.forces_n)
    return nominal


def problem_of(recording: Recording, simulator: ArmSimulator, nominal: Array) -> Problem:
    """The recording as the search works on it.

    Rows do not count where the arm has more than one place to rest in, or is about to.
    """
    used = has_one_equilibrium(nominal, simulator.arm)
    return prepare(simulator, recording.tensions_n, recording.trial, folds_of(recording), used)


def _candidate(ranked: Ranked, none: Hypothesis) -> CandidateResult:
    hypothesis = ranked.hypothesis or none
    return CandidateResult(
        effects=ranked.effects,
        held_out_rmse_n=hypothesis.held_out_rmse,
        probability=ranked.probability,
        held_out_ci95_n=rmse_interval_n(hypothesis.squares, hypothesis.count),
    )
