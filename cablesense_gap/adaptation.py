"""A force estimator that is trained on the amended arm of a diagnosis.

Some trials are withheld: neither the diagnosis nor the training has their readings, and the
estimators before and after are judged on their loads. The new one is trained on the amended arm,
over the poses and forces of the one in use, with a memory if the arm depends on history.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array, CableSenseError
from cablesense_gap.arm_system import Diagnosis, diagnose, folds_of
from cablesense_gap.recorded_contacts import (
    RecordedErrors,
    answer_at,
    at_contact_points,
    contact_errors,
    loads_at_m,
    recorded_errors,
    tares_n,
    with_acting_loads,
    without_history_n,
)
from cablesense_gap.recordings.recording import Recording
from cablesense_gap.verdict import EstimatorErrors
from cablesense_sim.arm import Arm
from cablesense_sim.contact_location import locate, touched_at
from cablesense_sim.load_capacity import contact_range_n
from cablesense_training.errors import DatasetError
from cablesense_training.evaluation.metrics import ContactAnswer, angle_difference_deg
from cablesense_training.fit import EpochRecord, OnEpoch
from cablesense_training.inference.anywhere import AnywhereEstimator
from cablesense_training.inference.estimator import NORMAL_95, Estimator, SequenceEstimator
from cablesense_training.inference.history_simulation import (
    HistorySimulation,
    depends_on_history,
    without_history,
)
from cablesense_training.inference.metadata import HISTORY_SIMULATED
from cablesense_training.inference.temporal_estimator import open_estimator
from cablesense_training.model_training import (
    balance_answer,
    contact_answer,
    draw_training_data,
    recipe_for,
    train_model,
)
from cablesense_training.networks.layers import ContactNetwork
from cablesense_training.networks.statics import AnywhereStatics, CorrectedClosedForm
from cablesense_training.networks.temporal import TemporalNetwork

_SAMPLES, _EPOCHS, _TEST_SAMPLES = 4096, 8, 512
"""A small training: the network only corrects a closed form."""
_ANYWHERE = "anywhere"
_ERROR_LEFT, _CONTACTS_LOST = 0.95, 0.01
"""A better estimator leaves at most this share of the force error, and names at most this share of
the contacts less: one that names fewer contacts has small errors for the wrong reason."""


class AdaptationError(CableSenseError):
    """A recording that no estimator can be adapted by: says what is missing."""


@dataclass(frozen=True)
class Adaptation:
    """A diagnosis, and errors of the estimators on the loads of the withheld trials.

    Attributes:
        trials: numbers of these trials.
        before: of the estimator in use.
        after: of the new one; None if the diagnosis names no effect to train on.
        better: whether the new one is to be used.
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
    *,
    force: bool = False,
) -> Adaptation:
    """Diagnose, train on the amended arm, and judge the models in the files `first` and `second`.

    The second is written if the diagnosis names effects, with `command` in its metadata. See
    `diagnose` for the other arguments and for errors.

    Raises:
        AdaptationError: too few loads to withhold some.
        ModelFileError: `first` is no model of single contacts of this arm.
    """
    open_estimator(first, arm)
    unseen = withheld_trials(recording, arm)
    diagnosed = 0.7  # of the whole time; the training takes 0.1

    def show(doing: str, done: float) -> None:
        progress(doing, diagnosed * done)

    def show_training(record: EpochRecord) -> None:
        progress("training for the amended arm", diagnosed + 0.1 * record.epoch / _EPOCHS)

    found = diagnose(recording, arm, show, workers, on_finding, unseen, force=force)
    progress("drawing samples of the amended arm", diagnosed)
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
    """The part of `adapt` that follows the diagnosis, which has not seen some trials.

    Estimators are judged on the loads that acted, as the load cell may have errors.
    """
    recording = with_acting_loads(recording, found.amended)
    estimator = open_estimator(first)
    anywhere = network_for(estimator, found.amended) == _ANYWHERE  # both judged on the same loads
    before, after, better = recorded_errors(recording, estimator, unseen, anywhere), None, False
    if found.verdict.shares:
        train_for(found.amended, estimator, recording, unseen, second, command, on_epoch)
        trained = open_estimator(second, found.amended)
        after = recorded_errors(recording, trained, unseen, anywhere)
        better = _is_better(before, after)
    errors = EstimatorErrors(
        before=_figures(before),
        after=None if after is None else _figures(after),
        use="after" if better else "before",
        trials=unseen,
    )
    verdict = found.verdict.model_copy(update={"estimator": errors})
    return Adaptation(replace(found, verdict=verdict), unseen, before, after, better)


def withheld_trials(recording: Recording, arm: Arm) -> tuple[int, ...]:
    """Numbers of the trials that the estimators are judged on: the fold with the most loads.

    If that has all loads, one of its trials, so that the others are left to learn from. Loads at
    the arm file's contact points count, as some models know no others, or all if few are there.

    Raises:
        AdaptationError: fewer than two trials have a load that can be estimated.
    """
    can_be_estimated = (recording.load_segment > 0) & np.isfinite(tares_n(recording)).all(axis=1)
    numbers, folds = np.unique(recording.trial), folds_of(recording)
    of_every_model = can_be_estimated & at_contact_points(recording, arm)
    if len(np.unique(recording.trial[of_every_model])) > 1:
        can_be_estimated = of_every_model
    loaded = np.isin(numbers, recording.trial[can_be_estimated])
    if loaded.sum() < 2:
        raise AdaptationError(
            f"{recording.name}: {loaded.sum()} trials have a load that follows "
            "unloaded rows at its command; at least 2 are needed, one to learn from and one to be "
            "judged on: record load cycles (cablesense gap protocol)"
        )
    withheld = folds == int(np.bincount(folds[loaded]).argmax())
    if withheld[loaded].all():
        withheld = np.arange(len(numbers)) == np.flatnonzero(loaded)[-1]
    return tuple(int(number) for number in numbers[withheld])


def network_for(first: Estimator | SequenceEstimator, arm: Arm) -> str:
    """The network to train for an arm: of contacts anywhere if those of the first model are.

    That of an arm that depends on its history knows contacts at the arm file's points alone.
    """
    if depends_on_history(arm):
        return HISTORY_SIMULATED
    anywhere = isinstance(first, AnywhereEstimator)
    return _ANYWHERE if anywhere else "closed-form-corrected"


def train_for(
    arm: Arm,
    first: Estimator | SequenceEstimator,
    recording: Recording,
    unseen: Collection[int],
    path: Path,
    command: str,
    on_epoch: OnEpoch = lambda _: None,
) -> None:
    """Train a network for an arm over the poses and forces of a first model, into a file.

    History-dependent effects are known to it by a simulation that runs with the network. Poses go
    as far as those of the recording if these are larger, and forces as far as the arm bears. Its
    intervals are widened until they hold the forces of the trials other than `unseen`.
    """
    metadata, has_history = first.metadata, depends_on_history(arm)
    network = network_for(first, arm)
    arm = arm if has_history else without_history(arm)
    pose_deg = float(np.rad2deg(np.abs(recording.command_rad).max()))
    options: dict[str, Any] = {
        "samples": _SAMPLES,
        "pose": "random",
        "pose_range_deg": max(metadata.pose_range_deg, np.ceil(pose_deg)),
        "force_high_n": contact_range_n(arm, metadata.force_range_n),
    }
    for attempt in range(5):  # with smaller forces if the arm does not bear these in every pose
        try:
            data = draw_training_data(arm, network, options, seed=0)
            break
        except DatasetError:
            if attempt == 4:
                raise
            options["force_high_n"] *= 0.7

    def widen(trained: ContactNetwork | TemporalNetwork) -> None:
        assert isinstance(trained, CorrectedClosedForm | AnywhereStatics)
        unseen_n = np.zeros((0, 2))  # the uncertainty that the simulation states of each answer

        def answering(taken: Recording, tare_n: Array, rows: NDArray[np.bool_]) -> ContactAnswer:
            nonlocal unseen_n
            difference_n, hidden_n = taken.tensions_n - tare_n, np.zeros((len(taken), 2))
            if has_history:
                simulation = HistorySimulation(arm, metadata.tare_samples)
                difference_n, hidden_n = without_history_n(taken, tare_n, simulation)
            unseen_n = hidden_n[rows]
            if isinstance(trained, AnywhereStatics):
                balance = balance_answer(trained, difference_n[rows], taken.command_rad[rows])
                located = locate(balance, *touched_at(arm))
                at_m = loads_at_m(taken, arm)[rows]
                return answer_at(located, taken.load_segment[rows], at_m)
            return contact_answer(trained, difference_n[rows], taken.command_rad[rows])

        anywhere = isinstance(trained, AnywhereStatics)
        seen = set(np.unique(recording.trial)) - set(unseen)
        errors = contact_errors(recording, arm, answering, seen, anywhere)
        off = np.abs(errors.truth.magnitude_n - errors.answer.magnitude_n)
        turned = np.abs(angle_difference_deg(errors.answer.angle_deg, errors.truth.angle_deg))
        found = (errors.truth.segment > 0) & (errors.truth.segment == errors.answer.segment)
        if not found.any():  # there is no error to widen by, and the model will not be used
            return
        stated = errors.answer.magnitude_std_n, errors.answer.angle_std_deg
        unseen_n[:, 1] = np.rad2deg(unseen_n[:, 1] / np.maximum(errors.answer.magnitude_n, 1e-9))
        wider = []
        for k, (error, std) in enumerate(zip((off, turned), stated, strict=True)):
            beyond = np.maximum(error**2 - unseen_n[:, k] ** 2, 0.0) ** 0.5
            ratio = beyond[found] / (NORMAL_95 * std[found])
            wider.append(max(1.0, float(np.quantile(ratio, 0.95))))
        if anywhere:  # one deviation of torques, of which both follow
            wider = [max(wider)]
        factor = trained.spread.factor
        factor.mul_(factor.new_tensor(wider))

    train_model(
        path,
        network,
        data,
        replace(recipe_for(network).settings, seed=0, threads=1, epochs=_EPOCHS, batch_size=256),
        command=command,
        test_samples=_TEST_SAMPLES,
        on_epoch=on_epoch,
        on_trained=widen,
    )


def _is_better(before: RecordedErrors, after: RecordedErrors) -> bool:
    first, second = before.whole.errors, after.whole.errors
    return (
        second.magnitude_mae_n < _ERROR_LEFT * first.magnitude_mae_n
        and second.contact_accuracy >= first.contact_accuracy - _CONTACTS_LOST
    )


def _figures(errors: RecordedErrors) -> dict[str, float]:
    """Errors over loaded rows, without those that average over no row."""
    of_loads = errors.whole.errors
    figures = {
        "contact_accuracy": of_loads.contact_accuracy,
        "force_mae_n": of_loads.magnitude_mae_n,
        "direction_mean_deg": of_loads.direction_mae_deg,
        "interval_coverage": of_loads.magnitude_coverage95,
        "false_force_n": errors.false_n,
        "rows": float(of_loads.contacts),
    }
    return {name: value for name, value in figures.items() if np.isfinite(value)}
