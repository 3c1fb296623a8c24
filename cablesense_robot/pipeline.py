"""From a recording of a robot and its model to a verdict, with the engine of `cablesense_gap`."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cablesense_base import Array
from cablesense_gap.budget import rest_of, shares
from cablesense_gap.diagnosis.probability import (
    ambiguity,
    bundled_calibration,
    named,
    posterior,
    rivals_of,
)
from cablesense_gap.diagnosis.problem import Hypothesis, Problem, prepare
from cablesense_gap.diagnosis.search import search
from cablesense_gap.pipeline import candidate_results, estimates, foremost, gap_size
from cablesense_gap.simulator import Assignment, Term
from cablesense_gap.verdict import Channel, Verdict, Where
from cablesense_robot.model import Robot
from cablesense_robot.motion import Motion, prepared
from cablesense_robot.protocol import next_experiment
from cablesense_robot.recording import RobotRecording
from cablesense_robot.simulator import RobotSimulator

UNIT = "floors"
FOLDS = 5
_FOLLOWS, _OTHER_UNIT = 0.8, 5.0
_FAR_OFF = 3.0
"""Standard deviations that one tolerance among many may be off."""


@dataclass(frozen=True)
class RobotDiagnosis:
    """A verdict, and torques measured and predicted.

    Attributes:
        amended: effects of the verdict and tolerances, as fitted.
        measured, before, after: (Q, C) compared torques in their own units; after by fits that
            have not seen the trial.
        findings: what was done to recording and model, and what is doubtful, as sentences.
    """

    robot: Robot
    motion: Motion
    verdict: Verdict
    amended: dict[Term, float]
    channels: tuple[str, ...]
    measured: Array
    before: Array
    after: Array
    findings: tuple[str, ...]


def diagnose(
    recording: RobotRecording,
    robot: Robot,
    beside: Assignment | None = None,
    bandwidth_hz: float | None = None,
    progress: Callable[[str, float], None] = lambda *_: None,
    workers: int = 1,
) -> RobotDiagnosis:
    """Find what makes the recorded robot differ from its model.

    `beside` are effects that an amended model lists beside its MJCF.

    Raises:
        RecordingError: the recording cannot be compared.
    """
    began = time.monotonic()
    progress("smoothing", 0.0)
    motion = prepared(recording, robot, bandwidth_hz)
    simulator = RobotSimulator(robot, motion, beside or {})
    problem = problem_of(simulator)
    calibration = bundled_calibration()
    hypotheses = [_with_outliers(problem, each) for each in search(problem, progress, workers)]
    found = posterior(hypotheses, problem.floor, calibration)
    ranked = named(problem, found, calibration)
    progress("describing the verdict", 0.98)
    best = ranked[0].hypothesis
    none = next(
        r.hypothesis for r in ranked if r.hypothesis is not None and not r.hypothesis.effects
    )
    explained = best or none
    values = foremost(explained, simulator.candidates)
    group, reasons = ambiguity(problem, ranked, UNIT)
    if best is None:
        reasons = _unlisted(problem, [r.hypothesis for r in ranked if r.hypothesis], simulator)
    weighed = [values, *(r.hypothesis.values for r in rivals_of(ranked) if r.hypothesis)]
    rest = rest_of(problem, explained)
    before, after = problem.readings - problem.nominal, problem.readings - explained.held_out
    alone = problem.readings - best.held_out_effects if best and best.effects else None
    verdict = Verdict(
        effects=ranked[0].effects,
        probability=ranked[0].probability,
        ambiguity_group=group,
        next_experiment=next_experiment(robot, weighed if best else [], motion.floor),
        where=_where(robot, values),
        parameters=estimates(values, explained.deviations, simulator.candidates),
        shares=shares(problem, ranked, values),
        tolerances_n=rest.tolerances,
        unexplained_n=rest.unexplained,
        unexplained_share=rest.share,
        gap=gap_size(before, after, problem.trial, problem.floor, alone),
        candidates=candidate_results(ranked),
        why=reasons,
        seconds=time.monotonic() - began,
        recording=recording.name,
        rows=len(recording),
        rows_used=len(problem.trial),
        arm=robot.name,
        unit=UNIT,
        channels=_channels(simulator, before, after),
    )
    progress("done", 1.0)
    unit = simulator.unit
    return RobotDiagnosis(
        robot=robot,
        motion=motion,
        verdict=verdict,
        amended={**values, **explained.tolerances},
        channels=tuple(robot.joints[j] for j in simulator.channels),
        measured=problem.readings * unit,
        before=problem.nominal * unit,
        after=explained.held_out * unit,
        findings=(
            *recording.notes,
            *robot.left_out,
            *doubtful(simulator, problem.nominal),
            _compared(motion),
        ),
    )


def problem_of(simulator: RobotSimulator) -> Problem:
    """The recording as the search works on it; all rows count."""
    trial = simulator.motion.compared_trial
    count = int(trial.max()) + 1
    fold = np.arange(count) % min(FOLDS, count)
    return prepare(simulator, simulator.readings, trial, fold, np.ones(len(trial), dtype=bool))


def _with_outliers(problem: Problem, hypothesis: Hypothesis) -> Hypothesis:
    """One tolerance far off counts as all of them off would.

    A robot has so many that one alone, as a delay of many samples, would not show in their sum.
    """
    std = dict(zip(problem.tolerance_terms, problem.tolerance_std, strict=True))
    tolerances = hypothesis.tolerances
    largest = max((abs(value) / std[term] for term, value in tolerances.items()), default=0.0)
    least = len(tolerances) * (largest / _FAR_OFF) ** 4
    return replace(hypothesis, tolerance_chi2=max(hypothesis.tolerance_chi2, least))


def doubtful(simulator: RobotSimulator, predicted: Array) -> list[str]:
    """Torques that follow the model's (Q, C), but with another sign or in another unit."""
    found = []
    for c, j in enumerate(simulator.channels):
        measured, nominal = simulator.readings[:, c], predicted[:, c]
        own, theirs = float(np.linalg.norm(measured)), float(np.linalg.norm(nominal))
        if own * theirs == 0.0:
            continue
        alike = float(measured @ nominal) / (own * theirs)
        ratio = own / theirs * float(np.sign(alike))
        if abs(alike) > _FOLLOWS and not 1.0 / _OTHER_UNIT < ratio < _OTHER_UNIT:
            found.append(
                f"torque.{simulator.robot.joints[j]} is {ratio:.2g} times what the model says: "
                "is its sign or unit another?"
            )
    return found


def _compared(motion: Motion) -> str:
    return (
        f"Compared by inverse dynamics: measured motion, smoothed to {motion.smoothed_hz:.3g} Hz, "
        f"in, torques out, with a bandwidth of {motion.compared_hz:.3g} Hz at "
        f"{len(motion.compared_trial):,} rows."
    )


def _where(robot: Robot, values: Mapping[Term, float]) -> Where:
    """Joints and bodies of the effects; of a coupling the joint whose drive it comes from."""
    places = {term.place.split("_into_")[0] for term in values}
    return Where(
        joints=tuple(joint for joint in robot.joints if joint in places),
        bodies=tuple(body for body in robot.bodies if body in places),
    )


def _channels(simulator: RobotSimulator, before: Array, after: Array) -> dict[str, Channel]:
    robot, motion = simulator.robot, simulator.motion
    sizes = [np.sqrt((each**2).mean(0)) for each in (before, after)]
    return {
        robot.joints[j]: Channel(
            unit=robot.torque_units[j],
            before=float(sizes[0][c] * motion.floor[j]),
            after=float(sizes[1][c] * motion.floor[j]),
            floor=float(motion.floor[j]),
        )
        for c, j in enumerate(simulator.channels)
    }


def _unlisted(
    problem: Problem, fitted: Sequence[Hypothesis], simulator: RobotSimulator
) -> tuple[str, ...]:
    none = next(h for h in fitted if not h.effects)
    best = min(fitted, key=lambda h: h.held_out_rmse)
    left = np.sqrt(((problem.readings - none.held_out) ** 2).mean(0))
    worst = int(left.argmax())
    return (
        f"Tolerances alone leave {none.held_out_rmse:.3g} floors on trials that were not fitted; "
        f"the best that listed effects do is {best.held_out_rmse:.3g} floors "
        f"({' with '.join(best.effects).replace('_', ' ') or 'none'}).",
        f"Most is left at {simulator.robot.joints[simulator.channels[worst]]}: "
        f"{left[worst]:.3g} floors.",
    )
