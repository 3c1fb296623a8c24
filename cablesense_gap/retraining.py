"""What a diagnosis does to the force estimator: trained for the nominal arm and for the amended.

Both are the pose-aware closed form with its small correction (`closed-form-corrected`) and
estimate the known loads of the recording, from tensions less a tare. For each fold of trials the
amended arm is fitted again without them; which effects were found, and where, stays.

An estimator is trained on the effects on the arm itself. For friction, creep and sensor effects
the amended arm is replayed under the loads that were estimated so far, with and without them, and
the difference is taken off the readings (`answers_with_past`), which the nodes do not do. The same
network trained on samples with friction instead trusts no reading any more, and misses contacts.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array, CableSenseError
from cablesense_base.workers import WorkerPool
from cablesense_gap.arm_simulator import ArmSimulator, amended_arm
from cablesense_gap.diagnosis.gauss_newton import refit
from cablesense_gap.diagnosis.problem import Problem
from cablesense_gap.pipeline import problem_of
from cablesense_gap.recorded_contacts import tares_n
from cablesense_gap.recordings.recording import Recording
from cablesense_gap.simulator import Term
from cablesense_gap.verdict import Estimator as Errors
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.effects.registry import known_effects
from cablesense_sim.equilibrium import EquilibriumError
from cablesense_sim.loads import normal_components_n, normal_force_n
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.replay import replay_arm
from cablesense_training.inference.estimator import Estimates, Estimator
from cablesense_training.model_training import draw_training_data, train_model
from cablesense_training.recipes import adjusted, recipe_for

NETWORK = "closed-form-corrected"
SAMPLES = 2048
EPOCHS = 6
AT_PEAK = 0.9
"""Rows count as being at a trial's peak from this share of its highest load on."""
PASSES = 4

_STEPS = 3
_LEAST_POSE_DEG = 1.0
_LEAST_FORCE = 0.4
"""Of the pretension."""
_BEYOND = 1.5
"""Samples go up to so many times the recording's highest load."""


class RetrainingError(CableSenseError):
    """A recording on which no estimator can be judged: names what it lacks."""


@dataclass(frozen=True)
class TaredLoads:
    """B loaded rows of a recording that have a tare.

    Attributes:
        row: (B,) numbers in the recording.
        tension_difference_n: (B, M) reading less tare.
        command_rad: (B, 2N) commanded joint angles.
        segment: (B,) 1 to N that the load acts on.
        force_n: (B, 3) the load, base frame.
        trial: (B,) position of the trial among those of the recording, from 0.
        at_peak: (B,) whether the load is near the highest of its trial.
    """

    row: NDArray[np.int64]
    tension_difference_n: Array
    command_rad: Array
    segment: NDArray[np.int64]
    force_n: Array
    trial: NDArray[np.int64]
    at_peak: NDArray[np.bool_]

    def __len__(self) -> int:
        """Number of rows B."""
        return len(self.row)


def tared_loads(recording: Recording) -> TaredLoads:
    """All loaded rows with a tare: the mean of the unloaded rows just before, at their command.

    A load under a command that was not rested at before has no tare and is left out.
    """
    tare = tares_n(recording)
    trial = np.unique(recording.trial, return_inverse=True)[1]
    size = np.linalg.norm(recording.load_n, axis=1)
    peak = np.zeros(int(trial.max(initial=0)) + 1)
    np.maximum.at(peak, trial, size)
    row = np.flatnonzero((recording.load_segment > 0) & np.isfinite(tare).all(axis=1))
    return TaredLoads(
        row=row,
        tension_difference_n=recording.tensions_n[row] - tare[row],
        command_rad=recording.command_rad[row],
        segment=recording.load_segment[row],
        force_n=recording.load_n[row],
        trial=trial[row],
        at_peak=size[row] >= AT_PEAK * peak[trial[row]],
    )


Answering = Callable[[TaredLoads], Array]
"""From loads to estimated forces (B, N, 3), base frame."""


def arm_alone(arm: Arm) -> Arm:
    """The arm with those of its effects that statics carries: those on the arm itself."""
    known = known_effects()
    kept = [e for e in arm.effects if known[e.effect].acts_on == "arm"]
    return arm.model_copy(update={"effects": kept})


def answers_with_past(recording: Recording, arm: Arm, answer: Answering) -> Array:
    """Forces (B, N, 3) on the loads of a recording (`tared_loads`), estimated with the past known.

    `answer` is an estimator for `arm_alone(arm)`. Unloaded rows are known to be so, as the tare is
    taken on them. Where the arm finds no rest under what was estimated, the last answers stand.
    """
    alone = arm_alone(arm)
    loads = tared_loads(recording)
    answers = answer(loads)
    if len(alone.effects) == len(arm.effects):
        return answers
    for _ in range(PASSES):
        forces = np.zeros((len(recording), *answers.shape[1:]))
        forces[loads.row] = answers
        try:
            whole, part = (
                replay_arm(each, recording.time_s, recording.command_rad, forces)
                for each in (arm, alone)
            )
        except EquilibriumError:
            break
        corrected = replace(recording, tensions_n=recording.tensions_n - (whole - part))
        answers = answer(tared_loads(corrected))
    return answers


def found_values(nominal: Arm, amended: Arm) -> dict[Term, float]:
    """The numbers of those effects that the amended arm lists beyond the nominal one.

    Manufacturing tolerances are left out.
    """
    known = known_effects()
    return {
        Term(listed.effect, listed.at, name): value
        for listed in amended.effects[len(nominal.effects) :]
        if not known[listed.effect].tolerance
        for name, value in listed.parameters.items()
    }


def without_fold(problem: Problem, fold: int, nominal: Arm, amended: Arm) -> Arm:
    """The amended arm, its numbers and tolerances fitted again without the trials of a fold.

    The choice of effects and places stays, which was made with these trials; so does the arm as
    it is where the fit finds no rest.
    """
    seen = replace(problem, used=problem.used & (problem.fold[problem.trial] != fold))
    fitted = refit(seen, found_values(nominal, amended), _STEPS)
    return amended_arm(nominal, fitted.values, fitted.tolerances) if fitted else amended


def answered_n(mechanism: Mechanism, loads: TaredLoads, estimates: Estimates) -> Array:
    """(B, N, 3) estimated forces in base axes; nothing where the answer is no contact."""
    magnitude_n = np.maximum(estimates.magnitude_n, 0.0)
    return normal_force_n(
        mechanism, loads.command_rad, estimates.segment, estimates.angle_deg, magnitude_n
    )


def force_errors(mechanism: Mechanism, loads: TaredLoads, answer_n: Array) -> dict[str, float]:
    """Errors of answers (B, N, 3) at the peaks of loads.

    `contact_accuracy` is the share of rows with the right segment, `force_mae_n` the mean error of
    the magnitude over all rows, no contact being 0 N, `direction_mean_deg` the mean angle between
    force and estimate over rows where a contact was found, and `loads` the number of loads. Of a
    load only what is normal to its segment counts, as nothing else can be felt.
    """
    y, z = normal_components_n(mechanism, loads.command_rad, loads.segment, loads.force_n)
    angle_deg = np.rad2deg(np.arctan2(y, z))
    normal = normal_force_n(mechanism, loads.command_rad, loads.segment, angle_deg, np.hypot(y, z))
    at = loads.at_peak
    truth, answer = normal.sum(1)[at], answer_n[at]
    size = np.linalg.norm(answer, axis=-1)
    segment = np.where(size.any(axis=1), size.argmax(axis=1) + 1, 0)
    force, true_force = answer.sum(1), np.linalg.norm(truth, axis=-1)
    found = (segment > 0) & (true_force > 0.0)
    cosine = (force * truth).sum(-1)[found] / (size.sum(1) * true_force)[found]
    errors = {
        "contact_accuracy": float(np.mean(segment == loads.segment[at])),
        "force_mae_n": float(np.abs(size.sum(1) - true_force).mean()),
        "loads": float(len(np.unique(loads.trial[at]))),
    }
    if found.any():
        angle = np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0)))
        errors["direction_mean_deg"] = float(angle.mean())
    return errors


def estimator_errors(
    recording: Recording,
    nominal: Arm,
    amended: Arm,
    progress: Callable[[str, float], None] = lambda *_: None,
    workers: int = 1,
) -> Errors:
    """Errors (`force_errors`) at the peaks of the recording's loads, before and after.

    Where the amended arm lists no effect beyond tolerances, both are alike. `progress` is called
    with what is under way and which share of it is done. Folds are shared out to `workers`
    processes.

    Raises:
        RetrainingError: the recording has no load with a tare before it.
    """
    loads = tared_loads(recording)
    if not len(loads):
        raise RetrainingError(
            f"{recording.name}: no load follows unloaded rows at its command, so there is no tare "
            "to judge an estimator with; record load cycles (cablesense gap protocol)"
        )
    mechanism = mechanism_of(nominal)
    progress("training for the nominal arm", 0.0)
    plain = trained_answering(nominal, mechanism, recording)(loads)
    before = force_errors(mechanism, loads, plain)
    if not found_values(nominal, amended):
        return Errors(before=before, after=before)
    progress("training for the amended arm", 0.1)
    simulator = ArmSimulator(nominal, recording)
    problem = problem_of(recording, simulator, simulator.predict([{}])[0])
    fold_of_row = problem.fold[loads.trial]
    folds = [int(fold) for fold in np.unique(fold_of_row)]
    answers = np.zeros_like(plain)
    with WorkerPool(workers, problem, recording, nominal, amended) as pool:
        for done, (fold, own) in enumerate(zip(folds, pool.map(_answered, folds), strict=True)):
            progress("training for the amended arm", (2 + done) / (2 + len(folds)))
            answers[fold_of_row == fold] = own[fold_of_row == fold]
    progress("trained", 1.0)
    return Errors(before=before, after=force_errors(mechanism, loads, answers))


def _answered(
    problem: Problem, recording: Recording, nominal: Arm, amended: Arm, fold: int
) -> Array:
    """Forces (B, N, 3) on all loads, by an estimator for the arm fitted without a fold."""
    arm = without_fold(problem, fold, nominal, amended)
    answer = trained_answering(arm_alone(arm), mechanism_of(nominal), recording)
    return answers_with_past(recording, arm, answer)


def trained_answering(arm: Arm, mechanism: Mechanism, recording: Recording) -> Answering:
    """An estimator trained for an arm over the poses and loads of a recording.

    Its forces are in base axes by the commands of `mechanism`.
    """
    pose_deg = float(np.rad2deg(np.abs(recording.command_rad).max()))
    force_n = float(np.linalg.norm(recording.load_n, axis=1).max())
    options: dict[str, Any] = {
        "samples": SAMPLES,
        "pose": "random",
        "pose_range_deg": max(pose_deg, _LEAST_POSE_DEG),
        "force_high_n": max(_BEYOND * force_n, _LEAST_FORCE * arm.cables.pretension_n),
    }
    recipe = recipe_for(NETWORK).settings
    settings = adjusted(recipe, seed=0, threads=1, epochs=EPOCHS, batch_size=256)
    data = draw_training_data(arm, NETWORK, options, seed=0)
    command = "cablesense gap diagnose --retrain"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.onnx"
        train_model(path, NETWORK, data, settings, command=command, test_samples=64)
        estimator = Estimator.load(path, arm)

    def answer(loads: TaredLoads) -> Array:
        estimates = estimator.estimate_batch(loads.tension_difference_n, loads.command_rad)
        return answered_n(mechanism, loads, estimates)

    return answer
