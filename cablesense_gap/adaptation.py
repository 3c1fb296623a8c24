"""From a diagnosis to a force estimator that is put right by it.

Some trials are kept apart: neither the diagnosis nor the training has their readings, and the
estimator before and the one after are judged on their loads. The second is trained on the amended
arm, over the poses and forces of the first, with a memory where the arm has one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array, CableSenseError
from cablesense_gap.arm_system import Diagnosis, diagnose, folds_of
from cablesense_gap.recorded_contacts import (
    RecordedErrors,
    contact_errors,
    recorded_errors,
    tares_n,
    with_acting_loads,
    without_history_n,
)
from cablesense_gap.recordings.recording import Recording
from cablesense_gap.verdict import EstimatorErrors
from cablesense_sim.arm import Arm
from cablesense_sim.load_capacity import contact_range_n
from cablesense_training.data.dataset import Dataset
from cablesense_training.data.sequences import Sequences
from cablesense_training.errors import DatasetError
from cablesense_training.evaluation.metrics import ContactAnswer, angle_difference_deg
from cablesense_training.fit import EpochRecord, OnEpoch
from cablesense_training.inference.estimator import NORMAL_95, Estimator, SequenceEstimator
from cablesense_training.inference.history_simulation import (
    HistorySimulation,
    depends_on_history,
    without_history,
)
from cablesense_training.inference.metadata import HISTORY_SIMULATED
from cablesense_training.inference.temporal_estimator import open_estimator
from cablesense_training.model_training import contact_answer, draw_training_data, train_model
from cablesense_training.networks import Network
from cablesense_training.networks.corrected import CorrectedClosedForm
from cablesense_training.networks.temporal import TemporalNetwork
from cablesense_training.recipes import adjusted, recipe_for

NETWORK = "closed-form-corrected"
_SAMPLES, _EPOCHS, _TEST_SAMPLES = 4096, 8, 512
_WEAKER = 4
"""How often forces to train on are lowered by three tenths where an arm does not bear them."""
_LESS = 0.95
"""Of the first estimator's force error: so much must the second be below it."""
_CONTACTS_GIVEN_UP = 0.01
"""Of the rows: a second estimator that names fewer is no better, however small its errors."""
_DIAGNOSIS_SHARE, _TRAINING_SHARE = 0.7, 0.1
"""Of the time that all takes."""


class AdaptationError(CableSenseError):
    """A recording or a model that nothing can be adapted by: names what is missing."""


@dataclass(frozen=True)
class Adaptation:
    """A diagnosis, and errors of the estimators on the loads of the trials that it has not seen.

    Attributes:
        trials: numbers of these trials.
        before: of the first estimator.
        after: of the second; none where the diagnosis names nothing to train on.
        better: whether the second is to be used: it errs less, and names no fewer contacts.
    """

    diagnosis: Diagnosis
    trials: tuple[int, ...]
    before: RecordedErrors
    after: RecordedErrors | None
    better: bool


def adapt(
    recording: Recording,
    arm: Arm,
    first: Path,
    second: Path,
    command: str,
    progress: Callable[[str, float], None] = lambda *_: None,
    workers: int = 1,
    on_finding: Callable[[str], None] = lambda _: None,
) -> Adaptation:
    """Diagnose, train on the amended arm, and judge the models in the files `first` and `second`.

    The second is written where the diagnosis names effects, `command` into it. See `diagnose` for
    the other arguments and for errors.

    Raises:
        AdaptationError: too few loads to keep some apart.
        ModelFileError: `first` is no model of single contacts of this arm.
    """
    open_estimator(first, arm)
    unseen = kept_apart(recording)

    def show(doing: str, done: float) -> None:
        progress(doing, _DIAGNOSIS_SHARE * done)

    found = diagnose(recording, arm, show, workers, on_finding, unseen)

    def show_training(record: EpochRecord) -> None:
        share = record.epoch / _EPOCHS
        progress("training for the amended arm", _DIAGNOSIS_SHARE + _TRAINING_SHARE * share)

    progress("drawing samples of the amended arm", _DIAGNOSIS_SHARE)
    adapted = adapt_to(found, recording, unseen, first, second, command, show_training)
    progress("done", 1.0)
    return adapted


def adapt_to(
    found: Diagnosis,
    recording: Recording,
    unseen: tuple[int, ...],
    first: Path,
    second: Path,
    command: str,
    on_epoch: OnEpoch = lambda _: None,
) -> Adaptation:
    """What follows in `adapt` from a diagnosis that has not seen some trials.

    Estimators are judged on the loads that acted, which a load cell may have got wrong.
    """
    recording = with_acting_loads(recording, found.amended)
    estimator = open_estimator(first)
    before, after, better = recorded_errors(recording, estimator, unseen), None, False
    if found.verdict.shares:
        seen = recording.rows(~np.isin(recording.trial, unseen))
        train_for(found.amended, estimator, seen, second, command, on_epoch)
        after = recorded_errors(recording, open_estimator(second, found.amended), unseen)
        better = _is_better(before, after)
    errors = EstimatorErrors(
        before=_named(before),
        after=None if after is None else _named(after),
        use="after" if better else "before",
        trials=unseen,
    )
    verdict = found.verdict.model_copy(update={"estimator": errors})
    return Adaptation(replace(found, verdict=verdict), unseen, before, after, better)


def kept_apart(recording: Recording) -> tuple[int, ...]:
    """Numbers of the trials that the estimators are judged on: the fold with the most loads.

    Where that is all loads, one trial of them, so that the others are left to learn from.

    Raises:
        AdaptationError: fewer than two trials have a load that can be estimated.
    """
    can_be_estimated = (recording.load_segment > 0) & np.isfinite(tares_n(recording)).all(axis=1)
    numbers, folds = np.unique(recording.trial), folds_of(recording)
    loaded = np.isin(numbers, recording.trial[can_be_estimated])
    if loaded.sum() < 2:
        raise AdaptationError(
            f"{recording.name}: {loaded.sum()} trials have a load that follows unloaded rows at "
            "its command; at least 2 are needed, one to learn from and one to be judged on: "
            "record load cycles (cablesense gap protocol)"
        )
    fold = int(np.bincount(folds[loaded]).argmax())
    apart = folds == fold
    if apart[loaded].all():
        apart = np.arange(len(numbers)) == np.flatnonzero(loaded)[-1]
    return tuple(int(number) for number in numbers[apart])


def train_for(
    arm: Arm,
    first: Estimator | SequenceEstimator,
    recording: Recording,
    path: Path,
    command: str,
    on_epoch: OnEpoch = lambda _: None,
) -> None:
    """Train a network for an arm over the poses and forces of a first model, into a file.

    History-dependent effects are known to it by a simulation that runs with the network. Poses go
    as far as the recording's if that is farther, and forces as far as the arm bears. Its intervals
    are widened until they hold the forces of the recording.
    """
    network, metadata = NETWORK, first.metadata
    if depends_on_history(arm):
        network = HISTORY_SIMULATED
    else:
        arm = without_history(arm)
    pose_deg = float(np.rad2deg(np.abs(recording.command_rad).max()))
    options: dict[str, Any] = {
        "samples": _SAMPLES,
        "pose": "random",
        "pose_range_deg": max(metadata.pose_range_deg, np.ceil(pose_deg)),
        "force_high_n": contact_range_n(arm, metadata.force_range_n),
    }
    recipe = recipe_for(network).settings
    settings = adjusted(recipe, seed=0, threads=1, epochs=_EPOCHS, batch_size=256)
    data = _drawn(arm, network, options)

    def widen(trained: Network | TemporalNetwork) -> None:
        assert isinstance(trained, CorrectedClosedForm)
        unseen_n = np.zeros((0, 2))  # what the simulation states of each answer itself

        def answering(taken: Recording, tare_n: Array, rows: NDArray[np.bool_]) -> ContactAnswer:
            nonlocal unseen_n
            difference_n, hidden_n = taken.tensions_n - tare_n, np.zeros((len(taken), 2))
            if network == HISTORY_SIMULATED:
                simulation = HistorySimulation(arm, metadata.tare_samples)
                difference_n, hidden_n = without_history_n(taken, tare_n, simulation)
            unseen_n = hidden_n[rows]
            return contact_answer(trained, difference_n[rows], taken.command_rad[rows])

        errors = contact_errors(recording, arm, answering)
        off = np.abs(errors.truth.magnitude_n - errors.answer.magnitude_n)
        turned = np.abs(angle_difference_deg(errors.answer.angle_deg, errors.truth.angle_deg))
        found = (errors.truth.segment > 0) & (errors.truth.segment == errors.answer.segment)
        if not found.any():  # no error to widen by; such a model is then judged and not used
            return
        stated = errors.answer.magnitude_std_n, errors.answer.angle_std_deg
        unseen_n[:, 1] = np.rad2deg(unseen_n[:, 1] / np.maximum(errors.answer.magnitude_n, 1e-9))
        for k, (error, std) in enumerate(zip((off, turned), stated, strict=True)):
            beyond = np.maximum(error**2 - unseen_n[:, k] ** 2, 0.0) ** 0.5
            ratio = beyond[found] / (NORMAL_95 * std[found])
            trained.spread.factor[k] *= max(1.0, float(np.quantile(ratio, 0.95)))

    train_model(
        path,
        network,
        data,
        settings,
        command=command,
        test_samples=_TEST_SAMPLES,
        on_epoch=on_epoch,
        on_trained=widen,
    )


def _drawn(arm: Arm, network: str, options: dict[str, Any]) -> Dataset | Sequences:
    """Samples of an arm, with weaker forces where it does not bear these in every pose."""
    for _ in range(_WEAKER):
        try:
            return draw_training_data(arm, network, options, seed=0)
        except DatasetError:
            options = {**options, "force_high_n": 0.7 * options["force_high_n"]}
    return draw_training_data(arm, network, options, seed=0)


def _is_better(before: RecordedErrors, after: RecordedErrors) -> bool:
    first, second = before.whole.errors, after.whole.errors
    return (
        second.magnitude_mae_n < _LESS * first.magnitude_mae_n
        and second.contact_accuracy >= first.contact_accuracy - _CONTACTS_GIVEN_UP
    )


def _named(errors: RecordedErrors) -> dict[str, float]:
    """Errors over loaded rows; what there is nothing to average for is left out."""
    of_loads = errors.whole.errors
    named = {
        "contact_accuracy": of_loads.contact_accuracy,
        "force_mae_n": of_loads.magnitude_mae_n,
        "direction_mean_deg": of_loads.direction_mae_deg,
        "interval_coverage": of_loads.magnitude_coverage95,
        "false_force_n": errors.false_n,
        "rows": float(of_loads.contacts),
    }
    return {name: value for name, value in named.items() if np.isfinite(value)}
