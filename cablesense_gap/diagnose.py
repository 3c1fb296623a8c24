"""From a recording and a nominal arm to a verdict."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.amending import amended_arm
from cablesense_gap.arm_simulator import ArmSimulator
from cablesense_gap.course_features import course_features
from cablesense_gap.diagnosis.ambiguity import ambiguity, rivals_of
from cablesense_gap.diagnosis.belief import Belief, beliefs, bundled_calibration
from cablesense_gap.diagnosis.course import Course, prepare
from cablesense_gap.diagnosis.discrepancy import Discrepancy, discrepancy
from cablesense_gap.diagnosis.hypothesis import Hypothesis
from cablesense_gap.diagnosis.polishing import polish
from cablesense_gap.diagnosis.searching import search
from cablesense_gap.experiments import next_experiment
from cablesense_gap.findings import estimates, foremost, where
from cablesense_gap.folds import folds_of
from cablesense_gap.gap_size import gap_size, rmse_interval_n
from cablesense_gap.recordings.checks import check_recording
from cablesense_gap.recordings.recording import Recording
from cablesense_gap.residuals.decomposition import decompose
from cablesense_gap.residuals.regimes import regimes
from cablesense_gap.verdict import Candidate, Verdict
from cablesense_sim.arm import Arm
from cablesense_sim.replay import replay_arm

Array = NDArray[np.float64]

SLACK_N = 2.5
MOST_SLACK = 2
"""With more cables slack the arm has two places to rest in, and which is chance."""

UNLISTED_NEXT = (
    "Record again what the regimes above name, and change one thing at a time: "
    "`cablesense gap protocol` lists loads, poses and holds that part most effects."
)


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
    tell: Callable[[str, float], None] = lambda *_: None,
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
    tell("predicting the nominal arm", 0.0)
    simulator = ArmSimulator(arm, recording)
    nominal = _nominal(simulator, recording, arm)
    checked = check_recording(recording, arm, nominal)
    checked.raise_if_unusable()
    course = course_of(recording, simulator, nominal)
    ranked = beliefs(search(course, tell, workers), course.floor, bundled_calibration())
    tell("what it means", 0.98)
    none = next(b.hypothesis for b in ranked if b.effects == ("none",))
    assert none is not None
    found = ranked[0].hypothesis
    explained = none if found is None else polish(course, found)
    values = foremost(explained, tuple(simulator.candidates))
    unlisted = None if found is not None else _flexible(course, recording, none, arm)
    held_out = explained.held_out if unlisted is None else none.held_out + unlisted.held_out
    used = course.used
    before = recording.tensions_n - nominal
    regimes_ = tuple(regimes(decompose(recording.rows(used), before[used], course.floor, arm)))
    group = ambiguity(course, ranked)
    rivals = [b.hypothesis.values for b in rivals_of(ranked) if b.hypothesis is not None]
    verdict = Verdict(
        effects=ranked[0].effects,
        probability=ranked[0].probability,
        ambiguity_group=group.group,
        next_experiment=next_experiment(arm, [values, *rivals], course.floor).text
        if found is not None
        else UNLISTED_NEXT,
        where=where(values, regimes_),
        parameters=estimates(values, explained.deviations, tuple(simulator.candidates)),
        gap=gap_size(
            before[used],
            (recording.tensions_n - held_out)[used],
            course.trial[used],
            course.floor,
        ),
        candidates=tuple(_candidate(belief, none) for belief in ranked),
        why=group.reasons if unlisted is None else _unlisted_reasons(ranked, none, unlisted),
        seconds=time.monotonic() - began,
        recording=recording.name,
        arm=arm.name,
    )
    tell("done", 1.0)
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


def _flexible(
    course: Course, recording: Recording, none: Hypothesis, arm: Arm
) -> Discrepancy:
    """How far what is left repeats itself, whatever makes it."""
    return discrepancy(
        course_features(recording, course.nominal, arm),
        course.readings - none.held_out,
        course.trial,
        course.fold,
        course.used,
        course.floor,
    )


def _unlisted_reasons(
    ranked: Sequence[Belief], none: Hypothesis, found: Discrepancy
) -> tuple[str, ...]:
    best = min(
        (b.hypothesis for b in ranked if b.hypothesis is not None), key=lambda h: h.held_out_rmse
    )
    return (
        f"Tolerances alone leave {none.held_out_rmse:.2f} N on trials that were not fitted; the "
        f"best that listed effects do is {best.held_out_rmse:.2f} N "
        f"({' with '.join(best.effects).replace('_', ' ') or 'none'}).",
        f"A flexible model, which knows commands, loads, directions and time but no physics, "
        f"explains {max(found.explained_share, 0.0):.0%} of what is left on such trials.",
        "What is left goes most with: " + ", ".join(found.foremost) + ".",
    )


def course_of(recording: Recording, simulator: ArmSimulator, nominal: Array) -> Course:
    """The recording as the search works on it.

    Rows do not count where the arm has more than one place to rest in, or is about to.
    """
    used = (nominal < SLACK_N).sum(-1) <= MOST_SLACK
    return prepare(simulator, recording.tensions_n, recording.trial, folds_of(recording), used)


def _candidate(belief: Belief, none: Hypothesis) -> Candidate:
    hypothesis = belief.hypothesis or none
    return Candidate(
        effects=belief.effects,
        held_out_rmse_n=hypothesis.held_out_rmse,
        probability=belief.probability,
        held_out_ci95_n=rmse_interval_n(hypothesis.squares, hypothesis.count),
    )
