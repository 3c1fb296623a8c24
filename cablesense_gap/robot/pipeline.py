"""From a recording of a robot and its model to a verdict, with the engine of `cablesense_gap`."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from cablesense_base import Array
from cablesense_gap.budget import rest_of, shares
from cablesense_gap.diagnosis.gauss_newton import final_refinement, refit
from cablesense_gap.diagnosis.probability import (
    ambiguity,
    bundled_calibration,
    named,
    posterior,
    rivals_of,
)
from cablesense_gap.diagnosis.problem import Explanation, Problem, prepare
from cablesense_gap.diagnosis.search import search
from cablesense_gap.pipeline import candidate_results, estimates, foremost, gap_size
from cablesense_gap.robot.model import Robot
from cablesense_gap.robot.motion import Motion
from cablesense_gap.robot.preparation import prepared
from cablesense_gap.robot.protocol import next_experiment
from cablesense_gap.robot.recording import RobotRecording
from cablesense_gap.robot.simulator import Comparison, RobotSimulator
from cablesense_gap.simulator import Assignment, Candidate, Term
from cablesense_gap.verdict import ChannelGap, Verdict, Where

UNIT = "floors"
FOLDS = 5
_FOLLOWS, _OTHER_UNIT = 0.8, 5.0
_AT_ZERO = 0.002
"""Of a joint's span."""
_STEPS, _RENAMED = 12, 3
_FAR_OFF = 3.0
"""Standard deviations that one tolerance among many may be off."""


@dataclass(frozen=True)
class RobotDiagnosis:
    """A verdict, and what is compared, measured and predicted.

    Attributes:
        amended: effects of the verdict and tolerances, as fitted.
        comparison: by which rows and channels.
        before, after: (Q, C) predicted, in the channels' units; after by fits that have not seen
            the trial.
        findings: what was done to recording and model, and what is doubtful, as sentences.
    """

    robot: Robot
    motion: Motion
    verdict: Verdict
    amended: dict[Term, float]
    comparison: Comparison
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
    forward: bool | None = None,
    *,
    zeroed: bool = False,
) -> RobotDiagnosis:
    """Find what makes the recorded robot differ from its model.

    `beside` are effects that an amended model lists beside its MJCF; `forward` says whether to
    compare forward in time, by default where commands and no torques are recorded. With `zeroed`,
    where encoders were set to zero where each trial begins, each trial has the zeros that fit it.

    Raises:
        RecordingError: the recording cannot be compared.
    """
    began = time.monotonic()
    progress("smoothing", 0.0)
    motion = prepared(recording, robot, bandwidth_hz, forward, zeroed=zeroed)
    simulator = RobotSimulator(robot, motion, beside or {})
    comparison = simulator.comparison
    problem = problem_of(simulator)
    calibration = bundled_calibration()
    explanations = [_with_outliers(problem, each) for each in search(problem, progress, workers)]
    explanations = with_other_names(problem, robot, explanations)
    found = posterior(explanations, problem.floor, calibration)
    ranked = named(problem, found, calibration)
    progress("describing the verdict", 0.98)
    best = ranked[0].explanation
    none = next(
        r.explanation for r in ranked if r.explanation is not None and not r.explanation.effects
    )
    explained = best or none
    values = foremost(explained, simulator.candidates)
    group, reasons = ambiguity(problem, ranked, UNIT)
    if best is None:
        reasons = _unlisted(problem, [r.explanation for r in ranked if r.explanation], simulator)
    weighed = [values, *(r.explanation.values for r in rivals_of(ranked) if r.explanation)]
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
        channels=_channels(comparison, before, after),
        compared=comparison.description,
    )
    progress("done", 1.0)
    return RobotDiagnosis(
        robot=robot,
        motion=motion,
        verdict=verdict,
        amended={**values, **explained.tolerances},
        comparison=comparison,
        before=problem.nominal * comparison.noise,
        after=explained.held_out * comparison.noise,
        findings=(
            *recording.notes,
            *(() if motion.forward else robot.left_out),
            *beyond_range(recording, robot),
            *(() if zeroed else begun_at_zero(recording)),
            *doubtful(simulator, problem.nominal),
            comparison.description,
        ),
    )


def problem_of(simulator: RobotSimulator) -> Problem:
    """The recording as the search works on it; all rows count."""
    trial = simulator.comparison.trial
    count = int(trial.max()) + 1
    fold = np.arange(count) % min(FOLDS, count)
    return prepare(simulator, simulator.readings, trial, fold, np.ones(len(trial), dtype=bool))


def with_other_names(
    problem: Problem, robot: Robot, explanations: Sequence[Explanation]
) -> list[Explanation]:
    """Beside all, the most probable ones with other names for what is off about links in them.

    A wrong mass, a shifted centre and a payload change the same ten numbers of a link, each as
    its own law allows. A search that begins with one of them finds numbers for it that leave
    little, and then nothing that another one could add; so each is fitted in place of another.
    """
    calibration = bundled_calibration()

    def judged(one: Explanation) -> float:
        numbers = calibration.size / calibration.power * one.sizes
        return float(np.log(problem.cost_of(one)) + numbers)

    known = {h.effects: h for h in explanations}
    ranked = [r.explanation for r in posterior(explanations, problem.floor, calibration)]
    best = [h for h in ranked if h is not None and h.effects][:_RENAMED]
    of_links = {c.effect: c for c in problem.simulator.candidates if c.places == robot.bodies}
    for begun in best:
        names = set(begun.effects)
        for one, other in product(names & set(of_links), set(of_links) - names):
            fitted = refit(problem, _renamed(begun, one, of_links[other]), _STEPS)
            if fitted is not None:
                fitted = _with_outliers(problem, final_refinement(problem, fitted)[0])
                rival = known.setdefault(fitted.effects, fitted)
                known[fitted.effects] = min(rival, fitted, key=judged)
    return list(known.values())


def _renamed(begun: Explanation, one: str, other: Candidate) -> dict[Term, float]:
    """Values to begin with, of another effect in the places of one."""
    places = dict.fromkeys(term.place for term in begun.values if term.effect == one)
    kept = {term: value for term, value in begun.values.items() if term.effect != one}
    new = {Term(other.effect, at, p.name): p.default for at in places for p in other.parameters}
    return kept | new


def _with_outliers(problem: Problem, explanation: Explanation) -> Explanation:
    """One tolerance far off counts as all of them off would.

    A robot has so many that one alone, as a delay of many samples, would not show in their sum.
    """
    std = dict(zip(problem.tolerance_terms, problem.tolerance_std, strict=True))
    tolerances = explanation.tolerances
    largest = max((abs(value) / std[term] for term, value in tolerances.items()), default=0.0)
    least = len(tolerances) * (largest / _FAR_OFF) ** 4
    return replace(explanation, tolerance_chi2=max(explanation.tolerance_chi2, least))


def doubtful(simulator: RobotSimulator, predicted: Array) -> list[str]:
    """Channels that follow the model's (Q, C), but with another sign or in another unit."""
    found = []
    for c, column in enumerate(simulator.comparison.columns):
        measured, nominal = simulator.readings[:, c], predicted[:, c]
        own, theirs = float(np.linalg.norm(measured)), float(np.linalg.norm(nominal))
        if own * theirs == 0.0:
            continue
        alike = float(measured @ nominal) / (own * theirs)
        ratio = own / theirs * float(np.sign(alike))
        if abs(alike) > _FOLLOWS and not 1.0 / _OTHER_UNIT < ratio < _OTHER_UNIT:
            found.append(
                f"{column} is {ratio:.2g} times what the model says: is its sign or unit another?"
            )
    return found


def beyond_range(recording: RobotRecording, robot: Robot) -> list[str]:
    """Commands that the model's actuators clip, where they drive what is compared."""
    if np.isfinite(recording.torque).any():
        return []
    low, high = robot.model.actuator_ctrlrange.T
    most, least = recording.command.max(0), recording.command.min(0)
    clipped = robot.model.actuator_ctrllimited.astype(bool) & ((most > high) | (least < low))
    return [
        f"command.{robot.actuators[a]} goes from {least[a]:.3g} to {most[a]:.3g}, which the model "
        f"clips to its range of {low[a]:.3g} to {high[a]:.3g}."
        for a in np.flatnonzero(clipped)
    ]


def begun_at_zero(recording: RobotRecording) -> list[str]:
    """Whether all trials begin where all joints read zero: by chance, or because they were set."""
    position = recording.position
    begun = np.diff(recording.trial, prepend=recording.trial[0] - 1) != 0
    at_zero = np.abs(position[begun]) <= _AT_ZERO * np.ptp(position, axis=0)
    if begun.sum() < 2 or not at_zero.all():
        return []
    return ["All trials begin at zero; if encoders were set to zero there, say so with --zeroed."]


def _where(robot: Robot, values: Mapping[Term, float]) -> Where:
    """Places of the effects; of a coupling the joint whose drive it comes from."""
    places = {term.place.split("_into_")[0] for term in values}
    return Where(
        joints=tuple(joint for joint in robot.joints if joint in places),
        bodies=tuple(body for body in robot.bodies if body in places),
        tendons=tuple(tendon for tendon in robot.tendons if tendon in places),
    )


def _channels(comparison: Comparison, before: Array, after: Array) -> dict[str, ChannelGap]:
    sizes = [np.sqrt((each**2).mean(0)) * comparison.floor for each in (before, after)]
    columns = zip(comparison.names, comparison.units, *sizes, comparison.floor, strict=True)
    return {
        name: ChannelGap(unit=unit, before=float(b), after=float(a), floor=float(floor))
        for name, unit, b, a, floor in columns
    }


def _unlisted(
    problem: Problem, fitted: Sequence[Explanation], simulator: RobotSimulator
) -> tuple[str, ...]:
    none = next(h for h in fitted if not h.effects)
    best = min(fitted, key=lambda h: h.held_out_rmse)
    left = np.sqrt(((problem.readings - none.held_out) ** 2).mean(0))
    worst = int(left.argmax())
    return (
        f"Tolerances alone leave {none.held_out_rmse:.3g} floors on trials that were not fitted; "
        f"the best that listed effects do is {best.held_out_rmse:.3g} floors "
        f"({' with '.join(best.effects).replace('_', ' ') or 'none'}).",
        f"Most is left at {simulator.comparison.names[worst]}: {left[worst]:.3g} floors.",
    )
