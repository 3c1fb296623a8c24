"""Every single-contact model and its peers on fresh samples, with what noise allows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablesense_training.data.dataset import Dataset
from cablesense_training.data.protocols import SingleContact
from cablesense_training.evaluation.comparison import single_answer
from cablesense_training.evaluation.metrics import (
    ContactAnswer,
    ContactTruth,
    SingleContactMetrics,
    single_contact_metrics,
)
from cablesense_training.evaluation.noise_bound import NoiseBound, noise_bound
from cablesense_training.evaluation.settings import SETTINGS, TABLE2_MODELS, Setting
from cablesense_training.inference.estimator import Estimator
from cablesense_training.inference.model_files import find_model
from cablesense_training.peers.boosting import BoostingPeer, BoostingSettings

Array = NDArray[np.float64]

TEST_SEED, TRAIN_SEED = 20_260_002, 0
SHIPPED, TREES = "shipped", "gradient_boosting"
ESTIMATORS = (SHIPPED, "closed_form", "two_stage", TREES)
"""By the names of the comparison; `shipped` is the model that CableSense uses."""

LABELS = {
    SHIPPED: "shipped model",
    "closed_form": "closed form",
    "two_stage": "two-stage (the paper’s)",
    TREES: "gradient boosting",
}
TITLES = {
    "straight": "straight arm (the paper’s)",
    "random_pose": "poses within ±10°",
    "compliant": "compliant arm, poses ±10°",
    "tensions_only": "poses unknown",
    "table2": "three segments, straight",
}
FORCE_EDGES_N = np.array([0.0, 2.0, 5.0, 10.0, 20.0, 40.0, 70.0, 100.0, 150.0, 200.0])


@dataclass(frozen=True, eq=False)
class Tested:
    """One estimator's answers on a setting's samples, and its figures."""

    answer: ContactAnswer
    metrics: SingleContactMetrics


@dataclass(frozen=True, eq=False)
class SettingTest:
    """One setting.

    Attributes:
        name: of the setting, one of `TITLES`.
        truth: of the samples.
        tested: by the names of `ESTIMATORS`, those that there are.
        bound: what noise leaves of an efficient unbiased estimator.
        bound_by_force: the same between `FORCE_EDGES_N`.
    """

    name: str
    truth: ContactTruth
    tested: dict[str, Tested]
    bound: NoiseBound
    bound_by_force: tuple[NoiseBound, ...]

    def error_by_force_n(self, estimator: str) -> Array:
        """(bins,) mean absolute magnitude error; an answer of no contact counts as 0 N."""
        truth, answer = self.truth, self.tested[estimator].answer
        said = np.where(answer.segment > 0, answer.magnitude_n, 0.0)
        touched = truth.segment > 0
        error = np.abs(said - truth.magnitude_n)[touched]
        place = _bins(truth.magnitude_n[touched])
        counts = np.bincount(place, minlength=len(FORCE_EDGES_N) - 1)
        sums = np.bincount(place, error, minlength=len(FORCE_EDGES_N) - 1)
        return np.asarray(sums / np.maximum(counts, 1))


def all_settings() -> tuple[Setting, ...]:
    """The settings of `cablesense evaluate`, and the three-segment arm of Table II."""
    peers = {name: model for name, model in TABLE2_MODELS.items() if name != SHIPPED}
    table2 = Setting("table2", "cdsm_table2", "straight", TABLE2_MODELS[SHIPPED], peers)
    return (*SETTINGS, table2)


def answered_setting(
    setting: Setting, samples: int, training_samples: int, boosting: BoostingSettings
) -> SettingTest:
    """All estimators of a setting; trees are grown where there are samples to train on."""
    dataset = Dataset.from_protocol(setting.arm, setting.protocol(samples), TEST_SEED)
    tested = answered_models(setting, dataset)
    if training_samples:
        training = Dataset.from_protocol(
            setting.arm, setting.protocol(training_samples), TRAIN_SEED
        )
        tested[TREES] = _tested(dataset, BoostingPeer(training, boosting).answer(dataset))
    truth = _truth(dataset)
    touched = np.flatnonzero(truth.segment > 0)
    place = _bins(truth.magnitude_n[touched])
    return SettingTest(
        name=setting.name,
        truth=truth,
        tested=tested,
        bound=noise_bound(dataset),
        bound_by_force=tuple(
            noise_bound(dataset.select(touched[place == i])) for i in range(len(FORCE_EDGES_N) - 1)
        ),
    )


def answered_models(setting: Setting, dataset: Dataset) -> dict[str, Tested]:
    """The bundled models of a setting on a dataset."""
    models = {SHIPPED: setting.model, **setting.peers}
    return {
        name: _tested(dataset, single_answer(Estimator.load(find_model(model)), dataset))
        for name, model in models.items()
    }


def as_the_paper_tests(setting: Setting, samples: int) -> dict[str, Tested]:
    """The bundled models on samples without noise, each of them a contact."""
    protocol = SingleContact(
        samples=samples, pose=setting.pose, noise=False, no_contact_fraction=0.0
    )
    return answered_models(setting, Dataset.from_protocol(setting.arm, protocol, TEST_SEED))


def _tested(dataset: Dataset, answer: ContactAnswer) -> Tested:
    metrics = single_contact_metrics(_truth(dataset), answer, dataset.arm.segment_count)
    return Tested(answer, metrics)


def _truth(dataset: Dataset) -> ContactTruth:
    return ContactTruth(dataset.segment, dataset.angle_deg, dataset.magnitude_n)


def _bins(magnitude_n: Array) -> NDArray[np.int64]:
    place = np.searchsorted(FORCE_EDGES_N, magnitude_n, side="right") - 1
    return np.minimum(place, len(FORCE_EDGES_N) - 2)
