"""From a recording and a nominal arm to a verdict."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.amending import amended_arm
from cablesense_gap.arm_simulator import ArmSimulator
from cablesense_gap.diagnosis.ambiguity import ambiguity, rivals_of
from cablesense_gap.diagnosis.belief import Belief, beliefs, bundled_calibration
from cablesense_gap.diagnosis.course import Course, prepare
from cablesense_gap.diagnosis.hypothesis import Hypothesis
from cablesense_gap.diagnosis.searching import search
from cablesense_gap.experiments import next_experiment
from cablesense_gap.findings import estimates, foremost, where
from cablesense_gap.folds import folds_of
from cablesense_gap.gap_size import gap_size, rmse_interval_n
from cablesense_gap.one_rest import with_one_rest
from cablesense_gap.recordings.checks import check_recording
from cablesense_gap.recordings.recording import Recording
from cablesense_gap.residuals.decomposition import decompose
from cablesense_gap.residuals.regimes import regimes
from cablesense_gap.unlisted import describe_unlisted
from cablesense_gap.verdict import Candidate, Verdict
from cablesense_sim.arm import Arm
from cablesense_sim.replay import replay_arm

Array = NDArray[np.float64]


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
    explained = found or none
    values = foremost(explained, tuple(simulator.candidates))
    fitted = [b.hypothesis for b in ranked if b.hypothesis is not None]
    unlisted = None if found else describe_unlisted(course, recording, fitted, arm)
    held_out = explained.held_out if unlisted is None else unlisted.held_out_n
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
        if unlisted is None
        else unlisted.next_experiment,
        where=where(values, regimes_),
        parameters=estimates(values, explained.deviations, tuple(simulator.candidates)),
        gap=gap_size(
            before[used],
            (recording.tensions_n - held_out)[used],
            course.trial[used],
            course.floor,
        ),
        candidates=tuple(_candidate(belief, none) for belief in ranked),
        why=group.reasons if unlisted is None else unlisted.reasons,
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


def course_of(recording: Recording, simulator: ArmSimulator, nominal: Array) -> Course:
    """The recording as the search works on it.

    Rows do not count where the arm has more than one place to rest in, or is about to.
    """
    used = with_one_rest(nominal)
    return prepare(simulator, recording.tensions_n, recording.trial, folds_of(recording), used)


def _candidate(belief: Belief, none: Hypothesis) -> Candidate:
    hypothesis = belief.hypothesis or none
    return Candidate(
        effects=belief.effects,
        held_out_rmse_n=hypothesis.held_out_rmse,
        probability=belief.probability,
        held_out_ci95_n=rmse_interval_n(hypothesis.squares, hypothesis.count),
    )
