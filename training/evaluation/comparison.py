"""The one evaluation of estimators: their errors on a dataset, and every bundled model compared.

A `Setting` is an arm, poses and the models that answer: the law that CableSense ships, asked for
contacts at the points of the arm file, and the paper's networks, with the noise bound on the same
fresh samples. The paper's Table II has tensions that were measured on the physical arm: loads of 1
and 2 kg hung at mid-segment on segments 1 to 3 of a three-segment, nine-cable arm, straight and
level.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_base.installation import config_path
from cablesense_contact.calibration import Calibrator, Unloaded
from cablesense_contact.errors import ModelFileError
from cablesense_contact.estimate import NORMAL_95
from cablesense_contact.felt_arm import FeltArm
from cablesense_contact.inference.estimator import Estimator, MultiEstimator
from cablesense_contact.inference.law_model import LawModel
from cablesense_contact.inference.metadata import find_model
from cablesense_contact.inference.single_contact import open_estimator
from cablesense_contact.judgement import largest_chi2
from cablesense_sim.arm import Arm, open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_training.data.dataset import Dataset
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.protocols import MultiContact, Pose, SingleContact
from cablesense_training.evaluation.law import exact_calibration
from cablesense_training.evaluation.metrics import (
    ContactAnswer,
    ContactTruth,
    MultiContactMetrics,
    NoiseBound,
    SingleContactMetrics,
    multi_contact_bound_n,
    multi_contact_metrics,
    noise_bound,
    plain_values,
    single_contact_metrics,
)
from cablesense_training.evaluation.points import CONTACT_NUMBERS, point_answer

SHIPPED = "shipped"
"""The model that CableSense uses in a setting, in reports."""

MULTI_ARM = "cdsm"
TWO_STAGE = "two_stage"
"""The paper's two-stage network, in reports."""
MULTI_MODELS = {TWO_STAGE: "peers/cdsm_multi_two_stage"}
"""Models for several contacts, by the name that reports use."""

TABLE2_MODELS = {SHIPPED: "cdsm_table2_anywhere", TWO_STAGE: "peers/cdsm_table2_two_stage"}
"""Models of the three-segment arm, likewise."""

STANDARD_GRAVITY_M_S2 = 9.81
"""The paper's conversion: its 2 kg load counts as 19.62 N."""

DOWN_DEG = 180.0
"""Contact angle of a hung load on the level arm: -z."""

_TABLE2_CABLES = 9
"""Of the arm of the paper's Table II."""

WEAKEST_MULTI_N = 5.0
"""Recognition of several contacts is judged on forces of at least this."""

_FIRM_N = 2.0
"""Below this force errors are not compared with the noise bound: noise decides them."""


@dataclass(frozen=True)
class Setting:
    """One column of the comparison, as `cablesense evaluate --json` names it; single contacts.

    Attributes:
        pose: straight, or joints within ± 10 degrees, which the law knows and networks do not.
        models: bundled models by the name that reports use; the first is the shipped one.
    """

    name: str
    arm_name: str
    pose: Pose
    models: dict[str, str]

    @property
    def arm(self) -> Arm:
        """The arm's description."""
        return open_arm(self.arm_name)

    def protocol(self, samples: int) -> SingleContact:
        """0 to 200 N on any segment from any side, or nothing; sensor noise and step on."""
        return SingleContact(samples=samples, pose=self.pose)


SETTINGS = (
    Setting(
        "straight",
        "cdsm",
        "straight",
        {SHIPPED: "cdsm_anywhere", TWO_STAGE: "peers/cdsm_straight_two_stage"},
    ),
    Setting(
        "random_pose",
        "cdsm",
        "random",
        {SHIPPED: "cdsm_anywhere", TWO_STAGE: "peers/cdsm_two_stage"},
    ),
    Setting("compliant", "cdsm_lab", "random", {SHIPPED: "cdsm_lab_anywhere"}),
)


def multi_protocol(samples: int) -> MultiContact:
    """None to N contacts at once on the straight arm, sensor noise and step on."""
    return MultiContact(samples=samples, pose="straight")


class Evaluation(NamedTuple):
    """An estimator's answers on a single-contact dataset, and their errors."""

    answer: ContactAnswer
    metrics: SingleContactMetrics


class MultiEvaluation(NamedTuple):
    """Touched segments (B, N), forces (B, N) on a multi-contact dataset, and their errors."""

    touched: NDArray[Any]
    magnitude_n: Array
    metrics: MultiContactMetrics


class SettingEvaluation(NamedTuple):
    """Models by name and the bound on the same samples.

    `firm_ratio` is the shipped model's magnitude MAE over the bound's, of contacts above 2 N.
    """

    models: dict[str, SingleContactMetrics]
    bound: NoiseBound
    firm_ratio: float


def evaluate_answer(answer: ContactAnswer, dataset: Dataset) -> Evaluation:
    """Errors of answers on a single-contact dataset."""
    truth = ContactTruth.of(dataset)
    return Evaluation(answer, single_contact_metrics(truth, answer, dataset.arm.segment_count))


def evaluate_estimator(estimator: Estimator, dataset: Dataset) -> Evaluation:
    """Answers of a single-contact model on a dataset, and their errors."""
    estimates = estimator.estimate_batch(dataset.tension_difference_n, dataset.command_rad)
    return evaluate_answer(ContactAnswer.of(estimates), dataset)


def evaluate_law(law: LawModel, dataset: Dataset) -> Evaluation:
    """Answers of a law on a dataset of contacts at the points of the arm file, and their errors.

    It takes the arm for exactly that of its file, as the dataset has it: a reading that no contact
    explains is answered with none.
    """
    answer = point_answer(
        law,
        exact_calibration(dataset.arm),
        dataset.unloaded_n + dataset.tension_difference_n,
        dataset.command_rad,
        mechanism_of(dataset.arm).contact_m,
        dataset.protocol.force_high_n,
        largest_chi2(dataset.arm.cable_count - CONTACT_NUMBERS),
    )
    return evaluate_answer(answer, dataset)


def evaluate_models(models: Mapping[str, str], dataset: Dataset) -> dict[str, Evaluation]:
    """Bundled models of one contact, or files, on a dataset of their arm."""
    evaluations = {}
    for name, model in models.items():
        opened = open_estimator(find_model(model), dataset.arm)
        if isinstance(opened, LawModel):
            evaluations[name] = evaluate_law(opened, dataset)
        else:
            evaluations[name] = evaluate_estimator(opened, dataset)
    return evaluations


def evaluate_multi_answer(
    touched: NDArray[Any], magnitude_n: Array, dataset: Dataset
) -> MultiEvaluation:
    """Errors of answers for several contacts, those below `WEAKEST_MULTI_N` left out."""
    metrics = multi_contact_metrics(
        dataset.contacts, dataset.magnitudes_n, touched, magnitude_n, WEAKEST_MULTI_N
    )
    return MultiEvaluation(touched, magnitude_n, metrics)


def evaluate_multi_models(dataset: Dataset) -> dict[str, MultiEvaluation]:
    """The `MULTI_MODELS` on a dataset."""
    evaluations = {}
    for name, model in MULTI_MODELS.items():
        estimator = MultiEstimator.load(find_model(model), dataset.arm)
        estimates = estimator.estimate_batch(dataset.tension_difference_n, dataset.command_rad)
        touched = estimates.probabilities > 0.5
        evaluations[name] = evaluate_multi_answer(touched, estimates.magnitude_n, dataset)
    return evaluations


def evaluate_setting(setting: Setting, dataset: Dataset) -> SettingEvaluation:
    """A setting's models and the noise bound on its samples."""
    evaluations = evaluate_models(setting.models, dataset)
    firm = dataset.magnitude_n > _FIRM_N
    known = dataset.select(firm)
    shipped = evaluate_answer(evaluations[SHIPPED].answer.select(firm), known).metrics
    return SettingEvaluation(
        models={name: evaluation.metrics for name, evaluation in evaluations.items()},
        bound=noise_bound(dataset),
        firm_ratio=shipped.errors.magnitude_mae_n / noise_bound(known).magnitude_mae_n,
    )


def compare(
    seed: int, samples: int, workers: int = 1, on_setting: Callable[[str], None] = lambda _: None
) -> dict[str, Any]:
    """Draw `samples` fresh samples a setting and let every bundled model answer.

    Gives plain values, as `cablesense evaluate --json` prints them.

    Raises:
        ModelFileError: a bundled model is missing or does not fit its arm.
    """
    for models in (*(setting.models for setting in SETTINGS), MULTI_MODELS):
        for model in models.values():
            find_model(model)
    single = {}
    bounds = {}
    coverages = []
    peers: dict[str, dict[str, Any]] = {}
    for setting in SETTINGS:
        on_setting(setting.name)
        dataset = draw_dataset(setting.arm, setting.protocol(samples), seed, workers=workers)
        evaluated = evaluate_setting(setting, dataset)
        shipped = evaluated.models.pop(SHIPPED)
        firm = {"mae_over_bound": evaluated.firm_ratio}
        single[setting.name] = metrics_json(shipped) | firm
        bounds[setting.name] = asdict(evaluated.bound)
        for name, metrics in evaluated.models.items():
            peers.setdefault(name, {})[setting.name] = metrics_json(metrics)
        coverages.append((shipped.errors.found, shipped.errors.magnitude_coverage95))
    on_setting("multi")
    dataset = draw_dataset(open_arm(MULTI_ARM), multi_protocol(samples), seed, workers=workers)
    multi = evaluate_multi_models(dataset)[TWO_STAGE].metrics
    shown = ("recognition_accuracy", "macro_f1", "magnitude_mae_n")
    return {
        "seed": seed,
        "samples": samples,
        "single": single,
        "multi": {name: getattr(multi, name) for name in shown}
        | {"bound_mae_n": multi_contact_bound_n(dataset, WEAKEST_MULTI_N).tolist()},
        "bound": bounds,
        "peers": peers,
        "coverage95": sum(n * share for n, share in coverages) / sum(n for n, _ in coverages),
    }


def metrics_json(metrics: SingleContactMetrics) -> dict[str, Any]:
    """One model's errors in one setting; None where there was nothing to average."""
    errors = asdict(metrics.errors) | {
        "contact_accuracy": metrics.contact_accuracy,
        "macro_f1": metrics.macro_f1,
        "coverage95": metrics.errors.magnitude_coverage95,
    }
    mae = ("contact_accuracy", "direction_mae_deg", "magnitude_mae_n")
    overall = {name: errors[name] for name in (*mae, "magnitude_rmse_n", "macro_f1", "coverage95")}
    by_force = [
        {"low_n": part.low_n, "high_n": part.high_n, "contacts": part.errors.contacts}
        | {name: getattr(part.errors, name) for name in mae}
        for part in metrics.bins
    ]
    return dict(plain_values({**overall, "by_force": by_force}))


class HungLoad(NamedTuple):
    """A load of Table II on a segment, `physical` or `simulated`, and changes (9,) of tensions."""

    source: str
    segment: int
    weight_n: float
    tension_difference_n: Array


def read_table2() -> list[HungLoad]:
    """The rows of Table II, physical and simulated, from the bundled file."""
    cables = [f"cable_{i + 1}_n" for i in range(_TABLE2_CABLES)]
    with config_path("measurements/table2.csv").open(newline="", encoding="utf-8") as file:
        return [
            HungLoad(
                source=row["source"],
                segment=int(row["load_segment"]),
                weight_n=float(row["load_kg"]) * STANDARD_GRAVITY_M_S2,
                tension_difference_n=np.array([float(row[name]) for name in cables]),
            )
            for row in csv.DictReader(file)
        ]


class HungLoadAnswer(NamedTuple):
    """A load of Table II, and what a model answers to it; `low_n` and `high_n` hold with 95 %."""

    load: HungLoad
    segment: int
    angle_deg: float
    magnitude_n: float
    low_n: float
    high_n: float


def evaluate_table2(model: LawModel | Estimator) -> list[HungLoadAnswer]:
    """The loads on the physical arm, with what a model of the three-segment arm answers to each.

    The law knows the arm as well as the tolerances of its file and one tare say. Both kinds of
    models take the loads to hang at the contact points, where they did.

    Raises:
        ModelFileError: the model is for an arm of other cables.
    """
    metadata = model.metadata
    if metadata.arm.cable_count != _TABLE2_CABLES:
        raise ModelFileError(
            f"a model of arm {metadata.arm_identity} with {metadata.arm.cable_count} cables; "
            f"Table II was measured on one with {_TABLE2_CABLES}, such as cdsm_table2"
        )
    loads = [load for load in read_table2() if load.source == "physical"]
    differences = np.stack([load.tension_difference_n for load in loads])
    answer = _table2_answer(model, differences)
    half_n = NORMAL_95 * answer.magnitude_std_n
    return [
        HungLoadAnswer(
            load,
            segment=int(answer.segment[row]),
            angle_deg=float(answer.angle_deg[row]),
            magnitude_n=float(answer.magnitude_n[row]),
            low_n=max(0.0, float(answer.magnitude_n[row] - half_n[row])),
            high_n=float(answer.magnitude_n[row] + half_n[row]),
        )
        for row, load in enumerate(loads)
    ]


def _table2_answer(model: LawModel | Estimator, differences_n: Array) -> ContactAnswer:
    """Answers to tension differences (B, M) of the straight arm."""
    arm = model.metadata.arm
    straight = np.zeros((len(differences_n), arm.joint_count))
    if isinstance(model, Estimator):
        return ContactAnswer.of(model.estimate_batch(differences_n, straight))
    mechanism = mechanism_of(arm)
    unloaded_n = solve_equilibrium(mechanism, straight[0]).tensions_n
    calibrator = Calibrator(FeltArm(arm), model)
    tare = Unloaded(unloaded_n, straight[0], count=1)
    tared = calibrator.updated(calibrator.by_tolerances(), tare)
    return point_answer(
        model,
        tared,
        unloaded_n + differences_n,
        straight,
        mechanism.contact_m,
        model.metadata.force_range_n,
    )
