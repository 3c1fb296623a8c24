"""From a recording and a nominal arm to a verdict."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.amending import amended_arm
from cablesense_gap.arm_simulator import ArmSimulator
from cablesense_gap.diagnosis.belief import Belief, beliefs, bundled_calibration
from cablesense_gap.diagnosis.course import Course, prepare
from cablesense_gap.diagnosis.hypothesis import Hypothesis
from cablesense_gap.diagnosis.searching import search
from cablesense_gap.findings import estimates, foremost, where
from cablesense_gap.folds import folds_of
from cablesense_gap.gap_size import gap_size, rmse_interval_n
from cablesense_gap.recordings.checks import check_recording
from cablesense_gap.recordings.recording import Recording
from cablesense_gap.residuals.decomposition import decompose
from cablesense_gap.residuals.regimes import regimes
from cablesense_gap.simulator import Term
from cablesense_gap.verdict import Candidate, Verdict
from cablesense_sim.arm import Arm

Array = NDArray[np.float64]

SLACK_N = 2.5
MOST_SLACK = 2
"""With more cables slack the arm has two places to rest in, and which is chance."""


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
    nominal = simulator.predict([{}])[0]
    checked = check_recording(recording, arm, nominal)
    checked.raise_if_unusable()
    course = course_of(recording, simulator, nominal)
    ranked = beliefs(search(course, tell, workers), course.floor, bundled_calibration())
    best = ranked[0]
    none = next(b.hypothesis for b in ranked if b.effects == ("none",))
    assert none is not None
    explained = best.hypothesis or none
    values = foremost(explained, tuple(simulator.candidates)) if best.hypothesis else {}
    used = course.used
    before = recording.tensions_n - nominal
    parts = decompose(recording.rows(used), before[used], course.floor, arm)
    verdict = Verdict(
        effects=best.effects,
        probability=best.probability,
        ambiguity_group=("+".join(best.effects),),
        where=where(values, tuple(regimes(parts))),
        parameters=estimates(values, explained.deviations, tuple(simulator.candidates)),
        gap=gap_size(
            before[used],
            (recording.tensions_n - explained.held_out)[used],
            course.trial[used],
            course.floor,
        ),
        candidates=tuple(_candidate(belief, none) for belief in ranked),
        seconds=time.monotonic() - began,
        recording=recording.name,
        arm=arm.name,
    )
    return Diagnosis(
        verdict=verdict,
        amended=_amended(arm, values, explained, best),
        predicted_before_n=nominal,
        predicted_after_n=explained.prediction,
        held_out_n=explained.held_out,
        findings=tuple(finding.text for finding in checked.findings),
    )


def course_of(recording: Recording, simulator: ArmSimulator, nominal: Array) -> Course:
    """The recording as the search works on it.

    Rows do not count where the arm has more than one place to rest in, or is about to.
    """
    used = (nominal < SLACK_N).sum(-1) <= MOST_SLACK
    return prepare(simulator, recording.tensions_n, recording.trial, folds_of(recording), used)


def _amended(arm: Arm, values: dict[Term, float], explained: Hypothesis, best: Belief) -> Arm:
    """An unlisted effect is in no library: its arm gets tolerances only as far as they go."""
    tolerances = explained.tolerances if best.hypothesis is not None else {}
    return amended_arm(arm, values, tolerances)


def _candidate(belief: Belief, none: Hypothesis) -> Candidate:
    hypothesis = belief.hypothesis or none
    return Candidate(
        effects=belief.effects,
        held_out_rmse_n=hypothesis.held_out_rmse,
        probability=belief.probability,
        held_out_ci95_n=rmse_interval_n(hypothesis.squares, hypothesis.count),
    )
