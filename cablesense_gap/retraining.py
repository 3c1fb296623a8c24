"""What a diagnosis does to the force estimator: trained for the nominal arm and for the amended.

Both are the pose-aware closed form with its small correction (`closed-form-corrected`) on a small
budget of samples, and answer the loads of the recording through the same estimator object. For
each fold of trials the amended arm is fitted again without them, an estimator is trained for that
arm, and answers the fold's loads. Which effects were found, and where, stays as the diagnosis had
it from all trials.

What effects change of the arm itself, the estimator is trained on. What depends on the past, and
what sensors do, one sample cannot tell: that is taken off the readings by replaying the amended
arm under what was estimated so far (`past_replayed`), which the nodes do not do. The same network
trained on samples with friction instead trusts no reading any more, and misses contacts.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.arm_simulator import ArmSimulator
from cablesense_gap.diagnose import course_of
from cablesense_gap.diagnosis.course import Course
from cablesense_gap.estimator_figures import answered_n, estimator_figures
from cablesense_gap.fold_refits import found_values, without_fold
from cablesense_gap.past_replayed import Answering, answers_with_past, arm_alone
from cablesense_gap.recordings.recording import Recording
from cablesense_gap.tared_loads import TaredLoads, tared_loads
from cablesense_gap.verdict import Estimator as Errors
from cablesense_msgs_py.errors import CableSenseError
from cablesense_sim.arm import Arm
from cablesense_sim.mechanism import Mechanism
from cablesense_training.inference.estimator import Estimator
from cablesense_training.recipes import adjusted, recipe_for
from cablesense_training.train_model import train_model
from cablesense_training.training_data import draw_samples

Array = NDArray[np.float64]

NETWORK = "closed-form-corrected"
SAMPLES = 2048
EPOCHS = 6
_BATCH = 256
_TEST_SAMPLES = 64
_LEAST_POSE_DEG = 1.0
_LEAST_FORCE_N = 20.0
_BEYOND = 1.5
"""Samples go up to so many times the recording's highest load."""


class RetrainingError(CableSenseError):
    """A recording on which no estimator can be judged: says what it lacks."""


def estimator_errors(
    recording: Recording,
    nominal: Arm,
    amended: Arm,
    tell: Callable[[str, float], None] = lambda *_: None,
    workers: int = 1,
) -> Errors:
    """Errors (`estimator_figures`) at the peaks of the recording's loads, before and after.

    Where the amended arm lists no effect beyond tolerances, after is as before. `tell` hears what
    is under way and which share of it is behind. Folds are shared out to `workers` processes.

    Raises:
        RetrainingError: the recording has no load with a tare before it.
    """
    loads = tared_loads(recording)
    if not len(loads):
        raise RetrainingError(
            f"{recording.name}: no load follows unloaded rows at its command, so there is no tare "
            "to judge an estimator with; record load cycles (cablesense gap protocol)"
        )
    mechanism = Mechanism.from_arm(nominal)
    tell("training for the nominal arm", 0.0)
    plain = _trained(nominal, mechanism, recording)(loads)
    before = estimator_figures(mechanism, loads, plain)
    if not found_values(nominal, amended):
        return Errors(before=before, after=before)
    tell("training for the amended arm", 0.1)
    simulator = ArmSimulator(nominal, recording)
    course = course_of(recording, simulator, simulator.predict([{}])[0])
    fold_of_row = course.fold[loads.trial]
    folds = [int(fold) for fold in np.unique(fold_of_row)]
    answers = np.zeros_like(plain)
    answered = partial(_answered, course, recording, nominal, amended)
    for done, (fold, own) in enumerate(zip(folds, _each(answered, folds, workers), strict=True)):
        tell("training for the amended arm", (2 + done) / (2 + len(folds)))
        answers[fold_of_row == fold] = own[fold_of_row == fold]
    tell("trained", 1.0)
    return Errors(before=before, after=estimator_figures(mechanism, loads, answers))


def _each(answered: Callable[[int], Array], folds: list[int], workers: int) -> Iterator[Array]:
    if workers == 1:
        yield from map(answered, folds)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        yield from pool.map(answered, folds)


def _answered(
    course: Course, recording: Recording, nominal: Arm, amended: Arm, fold: int
) -> Array:
    """Forces (B, N, 3) on all loads, by an estimator for the arm fitted without a fold."""
    arm = without_fold(course, fold, nominal, amended)
    answer = _trained(arm_alone(arm), Mechanism.from_arm(nominal), recording)
    return answers_with_past(recording, arm, answer)


def _trained(arm: Arm, mechanism: Mechanism, recording: Recording) -> Answering:
    """An estimator for an arm over the poses and loads of a recording.

    Its forces are in base axes by the commands of `mechanism`.
    """
    pose_deg = float(np.rad2deg(np.abs(recording.command_rad).max()))
    force_n = float(np.linalg.norm(recording.load_n, axis=1).max())
    options: dict[str, Any] = {
        "samples": SAMPLES,
        "pose": "random",
        "pose_range_deg": max(pose_deg, _LEAST_POSE_DEG),
        "force_high_n": max(_BEYOND * force_n, _LEAST_FORCE_N),
    }
    settings = adjusted(
        recipe_for(NETWORK).settings, seed=0, threads=1, epochs=EPOCHS, batch_size=_BATCH
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.onnx"
        train_model(
            path,
            NETWORK,
            draw_samples(arm, NETWORK, options, seed=0),
            settings,
            command="cablesense gap diagnose --retrain",
            test_samples=_TEST_SAMPLES,
        )
        estimator = Estimator.load(path, arm)

    def answer(loads: TaredLoads) -> Array:
        said = estimator.estimate_batch(loads.tension_difference_n, loads.command_rad)
        return answered_n(mechanism, loads, said)

    return answer
