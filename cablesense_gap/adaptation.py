"""From a diagnosis to an estimator that knows the arm: no training, some seconds.

Some trials are withheld: the diagnosis does not have their readings, and the estimators before and
after are judged on their loads. The new one is the law of the amended arm, with a calibration that
starts from what the diagnosis found of the arm's uncertain parameters. What neither explains, as
creep or play, counts as noise of its readings: noise that has directions, those of the residuals
that it left under the loads that the diagnosis has seen.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cablesense_base import Array, CableSenseError
from cablesense_contact.calibration import Calibration, Calibrator
from cablesense_contact.felt_arm import FeltArm
from cablesense_contact.inference.estimator import Estimator
from cablesense_gap.arm_nuisance import terms_of
from cablesense_gap.arm_system import Diagnosis, diagnose, folds_of
from cablesense_gap.kept_simulations import KeptSimulations
from cablesense_gap.recorded_contacts import (
    ArmLaw,
    RecordedErrors,
    RecordedMachine,
    arm_of,
    at_contact_points,
    recorded_errors,
    tares_of,
    those_settled,
    with_acting_loads,
)
from cablesense_gap.simulator import Term
from cablesense_gap.verdict import DECIDING_ERROR, EstimatorErrors
from cablesense_recording.recording import Recording
from cablesense_sim.arm import Arm
from cablesense_sim.effects.registry import known_effects
from cablesense_sim.uncertain_arm import arm_parameters
from cablesense_training.errors import TrainingError
from cablesense_training.law.build import TorchLaw
from cablesense_training.law_export import export_law

_ERROR_LEFT = 0.95
"""Share of the wrongly stated force that a better estimator leaves at most. A contact that is not
named counts in full, so that none is better by saying less."""


class AdaptationError(CableSenseError):
    """A recording that no estimator can be adapted by: says what is missing."""


@dataclass(frozen=True)
class AdaptedEstimator:
    """The law of an amended arm, and how well that arm is known.

    Attributes:
        law: in PyTorch.
        calibration: from the diagnosis.
        unexplained_n2: (M, M) covariance of readings by what the law does not know of the arm, N².
    """

    law: TorchLaw
    calibration: Calibration
    unexplained_n2: Array

    @property
    def unexplained_n(self) -> float:
        """Its root mean square over the readings."""
        return float(np.sqrt(np.diag(self.unexplained_n2).mean()))

    def export(self, path: Path, command: str) -> None:
        """Write the law as a model file, with the `command` that makes it again.

        Raises:
            TrainingError: as `export_law`.
        """
        export_law(self.law.arm, path, command, self.unexplained_n2)


@dataclass(frozen=True)
class Adaptation:
    """A diagnosis, and errors of the estimators on the loads of the withheld trials.

    Attributes:
        trials: numbers of these trials.
        before: of the estimator in use.
        after: of the new one; None if the diagnosis tells nothing new about the arm.
        better: whether the new one is to be used.
        adapted: the new one; None without it.
    """

    diagnosis: Diagnosis
    trials: tuple[int, ...]
    before: RecordedErrors
    after: RecordedErrors | None
    better: bool
    adapted: AdaptedEstimator | None

    def without_the_new(self) -> Adaptation:
        """The same where the new estimator cannot be used."""
        errors = self.diagnosis.verdict.estimator
        assert errors is not None
        kept = errors.model_copy(update={"after": None, "use": "before"})
        verdict = self.diagnosis.verdict.model_copy(update={"estimator": kept})
        diagnosis = replace(self.diagnosis, verdict=verdict)
        return replace(self, diagnosis=diagnosis, after=None, better=False, adapted=None)


class Exported(NamedTuple):
    """An adaptation whose new estimator is a model file, or why it cannot be one.

    Attributes:
        adaptation: without the new estimator where it was refused.
        refusal: why; empty if it was not.
    """

    adaptation: Adaptation
    refusal: str = ""


def exported(adaptation: Adaptation, path: Path, command: str) -> Exported:
    """Write the new estimator as a model file, with the `command` that makes it again."""
    if adaptation.adapted is None:
        return Exported(adaptation)
    try:
        adaptation.adapted.export(path, command)
    except TrainingError as error:
        return Exported(adaptation.without_the_new(), str(error))
    return Exported(adaptation)


def adapt(
    recording: Recording,
    arm: Arm,
    first: ArmLaw | Estimator | None = None,
    progress: Callable[[str, float], None] = lambda *_: None,
    workers: int = 1,
    on_finding: Callable[[str], None] = lambda _: None,
    *,
    force: bool = False,
    announce: Callable[[float], None] = lambda _: None,
    kept: KeptSimulations | None = None,
) -> Adaptation:
    """Diagnose a recording, and judge the estimator in use and that of the amended arm.

    `first` is the estimator in use, by default the law of the arm. `on_finding` receives each
    problem of the recording; `progress` the present step and the share that is done, `announce`
    the seconds that the search will take; `workers` processes share it. With `force` it continues
    if channels look exchanged. From the files `kept` one goes on that was interrupted.

    Raises:
        CableSenseError: as `arm_system.diagnose`: the recording or the arm cannot be used.
        AdaptationError: too few loads to withhold some.
    """
    unseen = withheld_trials(recording, arm)
    diagnosis = diagnose(
        recording,
        arm,
        progress,
        workers,
        on_finding,
        unseen,
        force=force,
        announce=announce,
        kept=kept,
    )
    progress("judging the estimators", 1.0)
    adapted = adapt_to(diagnosis, recording, unseen, first or TorchLaw(arm))
    progress("done", 1.0)
    return adapted


def adapt_to(
    found: Diagnosis, recording: Recording, unseen: tuple[int, ...], first: ArmLaw | Estimator
) -> Adaptation:
    """The part of `adapt` that follows the diagnosis, which has not seen some trials.

    Estimators are judged on the loads that acted, as the load cell may have errors. A law in use
    knows its arm by the tolerances; both laws take a tare before each load.
    """
    recording = with_acting_loads(recording, found.amended)
    anywhere = not isinstance(first, Estimator)  # both are judged on the same loads
    known = None
    if not isinstance(first, Estimator):
        known = Calibrator(FeltArm(arm_of(first)), first).by_tolerances()
    before = recorded_errors(recording, first, unseen, anywhere, known)
    adapted = None
    after = None
    better = False
    if found.verdict.shares or _tells_more(found):
        adapted = adapted_estimator(found, recording, unseen)
        after = recorded_errors(recording, adapted.law, unseen, anywhere, adapted.calibration)
        better = _is_better(before, after)
    errors = EstimatorErrors(
        before=_figures(before),
        after=None if after is None else _figures(after),
        use="after" if better else "before",
        trials=unseen,
    )
    verdict = found.verdict.model_copy(update={"estimator": errors})
    return Adaptation(replace(found, verdict=verdict), unseen, before, after, better, adapted)


def adapted_estimator(
    found: Diagnosis, recording: Recording, unseen: tuple[int, ...] = ()
) -> AdaptedEstimator:
    """The estimator of the amended arm; its noise is by the trials that the diagnosis has seen.

    The law is one of equilibrium, so that noise is what readings show that have settled: what a
    lag adds while a load changes is none. What a play or a joint's friction keeps from the cables
    lasts from reading to reading and has the direction of the load: only a covariance says so.
    """
    calibration = diagnosed_calibration(found)
    tares = tares_of(recording)
    rows = np.asarray(tares.of_row >= 0) & ~np.isin(recording.trial, unseen)
    rows = those_settled(recording, FeltArm(found.amended), rows)
    known = RecordedMachine(recording, tares, TorchLaw(found.amended), calibration)
    unexplained_n2 = known.unexplained_n2(rows)
    law = TorchLaw(found.amended, unexplained_n2)
    return AdaptedEstimator(law, calibration, unexplained_n2)


def diagnosed_calibration(found: Diagnosis) -> Calibration:
    """What a diagnosis tells of the amended arm's parameters, as deviations from its file.

    The file lists tolerances as they were fitted, from which these deviate by little. Zeros of
    sensors are known for the time of the recording; later each may have moved by its tolerance.
    """
    arm = found.amended
    parameters = arm_parameters(arm)
    mean = found.parameters.mean - _listed_deviations(arm)
    covariance = found.parameters.covariance.copy()
    zeros = np.arange(len(parameters))[parameters.slices["sensor_zero"]]
    covariance[zeros, zeros] += arm.tolerances.sensor_zero_n**2
    return Calibration(
        arm_identity=arm.identity,
        mean=mean,
        covariance=covariance,
        prior_mean=mean,
        prior_covariance=covariance,
        made_from=f"the diagnosis of {found.recording.name}",
    )


def _listed_deviations(arm: Arm) -> Array:
    """(P,) the tolerances that an arm file lists."""
    listed: dict[Term, float] = {}
    for entry in arm.effects:
        if known_effects()[entry.effect].tolerance:
            for name, value in entry.parameters.items():
                term = Term(entry.effect, entry.at, name)
                listed[term] = listed.get(term, 0.0) + value
    terms = terms_of(arm_parameters(arm))
    return np.array([0.0 if term is None else listed.get(term, 0.0) for term in terms])


def _tells_more(found: Diagnosis) -> bool:
    """Whether the diagnosis tells more about the arm's parameters than its tolerances do."""
    expected = arm_parameters(found.amended)
    same_mean = np.allclose(found.parameters.mean, expected.prior_mean)
    by_tolerances = np.diag(expected.prior_std**2)
    return not (same_mean and np.allclose(found.parameters.covariance, by_tolerances, atol=0.0))


def withheld_trials(recording: Recording, arm: Arm) -> tuple[int, ...]:
    """Numbers of the trials that the estimators are judged on: the fold with the most loads.

    If that has all loads, one of its trials, so that the others are left to learn from. Loads at
    the arm file's contact points count, as some models know no others, or all if few are there.

    Raises:
        AdaptationError: fewer than two trials have a load that can be estimated.
    """
    can_be_estimated = (recording.load_segment > 0) & (tares_of(recording).of_row >= 0)
    numbers = np.unique(recording.trial)
    folds = folds_of(recording)
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


def _is_better(before: RecordedErrors, after: RecordedErrors) -> bool:
    return after.wrong_n < _ERROR_LEFT * before.wrong_n


def _figures(errors: RecordedErrors) -> dict[str, float]:
    """Errors over loaded rows, without those that average over no row."""
    of_loads = errors.whole.errors
    figures = {
        DECIDING_ERROR: errors.wrong_n,
        "contact_accuracy": of_loads.contact_accuracy,
        "contacts_confirmed": errors.confirmed,
        "force_mae_n": of_loads.magnitude_mae_n,
        "direction_mean_deg": of_loads.direction_mae_deg,
        "interval_coverage": of_loads.magnitude_coverage95,
        "false_force_n": errors.false_n,
        "rows": float(of_loads.contacts),
    }
    return {name: value for name, value in figures.items() if np.isfinite(value)}
