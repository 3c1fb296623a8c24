"""Every setting, every estimator, on fresh samples: the figures of `cablesense evaluate`.

The settings that estimators are compared in: which arm, which poses, which models answer.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from typing import Any

from cablesense_sim.arm import Arm, open_arm
from cablesense_training.data.dataset import Dataset
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.protocols import MultiContact, Pose, SingleContact
from cablesense_training.evaluation.metrics import (
    ContactAnswer,
    ContactTruth,
    MultiContactMetrics,
    SingleContactMetrics,
    multi_contact_metrics,
    single_contact_metrics,
)
from cablesense_training.evaluation.noise_bound import NoiseBound, noise_bound
from cablesense_training.inference.estimator import Estimator, MultiEstimator
from cablesense_training.inference.metadata import find_model


@dataclass(frozen=True)
class Setting:
    """One column of the comparison.

    Attributes:
        name: as `cablesense evaluate --json` calls it.
        arm_name: bundled arm.
        pose: straight, or joints within ± 10 degrees.
        model: bundled model that CableSense ships for it.
        peers: bundled models to compare with, by the name the report uses.
    """

    name: str
    arm_name: str
    pose: Pose
    model: str
    peers: dict[str, str]

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
        "cdsm",
        {"closed_form": "peers/cdsm_closed_form", "two_stage": "peers/cdsm_straight_two_stage"},
    ),
    Setting(
        "random_pose",
        "cdsm",
        "random",
        "cdsm",
        {"closed_form": "peers/cdsm_closed_form", "two_stage": "peers/cdsm_two_stage"},
    ),
    Setting(
        "compliant",
        "cdsm_lab",
        "random",
        "cdsm_lab",
        {"closed_form": "peers/cdsm_lab_closed_form", "two_stage": "peers/cdsm_lab_two_stage"},
    ),
    Setting(
        "tensions_only",
        "cdsm",
        "random",
        "cdsm_tensions_only",
        {"two_stage": "peers/cdsm_two_stage"},
    ),
)
"""Single contact; random poses are known to the pose-aware models and unknown to the others."""

MULTI_ARM = "cdsm"
MULTI_MODEL = "cdsm_multi"
MULTI_PEERS = {"two_stage": "peers/cdsm_multi_two_stage"}
TABLE2_MODEL = "cdsm_table2"
TABLE2_MODELS = {
    "shipped": TABLE2_MODEL,
    "closed_form": "peers/cdsm_table2_closed_form",
    "two_stage": "peers/cdsm_table2_two_stage",
}
"""Models of the three-segment arm, by the name the report uses."""

WEAKEST_MULTI_N = 5.0
"""Multi-contact recognition is judged on forces of at least this."""


def multi_protocol(samples: int) -> MultiContact:
    """None to N contacts at once on the straight arm, sensor noise and step on."""
    return MultiContact(samples=samples, pose="straight")


FIRM_N = 2.0
"""Below this force the figures beside the noise bound are not compared: noise decides them."""


@dataclass(frozen=True)
class SettingFigures:
    """One setting: the shipped model, its peers, and the bound, all on the same samples.

    Attributes:
        firm_ratio: magnitude MAE over that of the bound, contacts above `FIRM_N`.
    """

    setting: str
    shipped: SingleContactMetrics
    peers: dict[str, SingleContactMetrics]
    bound: NoiseBound
    firm_ratio: float


@dataclass(frozen=True)
class Comparison:
    """All settings and the multi-contact model, for one seed."""

    seed: int
    samples: int
    settings: tuple[SettingFigures, ...]
    multi: dict[str, MultiContactMetrics]

    @property
    def coverage95(self) -> float:
        """Share of the shipped models' stated 95 % magnitude intervals that hold the truth."""
        known = [s.shipped.errors for s in self.settings]
        total = sum(e.found for e in known)
        return sum(e.magnitude_coverage95 * e.found for e in known) / total


def compare(
    seed: int, samples: int, workers: int = 1, on_setting: Callable[[str], None] | None = None
) -> Comparison:
    """Draw `samples` fresh samples a setting and let every bundled model answer.

    Raises:
        ModelFileError: a bundled model is missing or does not fit its arm.
    """
    for name in _models():
        find_model(name)
    figures = []
    for setting in SETTINGS:
        if on_setting is not None:
            on_setting(setting.name)
        dataset = draw_dataset(setting.arm, setting.protocol(samples), seed, workers=workers)
        figures.append(setting_figures(setting, dataset))
    if on_setting is not None:
        on_setting("multi")
    arm = open_arm(MULTI_ARM)
    dataset = draw_dataset(arm, multi_protocol(samples), seed, workers=workers)
    return Comparison(seed, samples, tuple(figures), multi_figures(dataset))


def _models() -> Iterable[str]:
    for setting in SETTINGS:
        yield from (setting.model, *setting.peers.values())
    yield from (MULTI_MODEL, *MULTI_PEERS.values())


def setting_figures(setting: Setting, dataset: Dataset) -> SettingFigures:
    """Figures of one setting's models on its samples."""
    shipped = single_figures(Estimator.load(find_model(setting.model), dataset.arm), dataset)
    firm = dataset.select(dataset.magnitude_n > FIRM_N)
    firm_error = single_figures(Estimator.load(find_model(setting.model)), firm).errors
    return SettingFigures(
        setting=setting.name,
        shipped=shipped,
        peers={
            name: single_figures(Estimator.load(find_model(peer), dataset.arm), dataset)
            for name, peer in setting.peers.items()
        },
        bound=noise_bound(dataset),
        firm_ratio=firm_error.magnitude_mae_n / noise_bound(firm).magnitude_mae_n,
    )


def single_figures(estimator: Estimator, dataset: Dataset) -> SingleContactMetrics:
    """Metrics of a single-contact model on a dataset."""
    truth = ContactTruth(dataset.segment, dataset.angle_deg, dataset.magnitude_n)
    answer = single_answer(estimator, dataset)
    return single_contact_metrics(truth, answer, dataset.arm.segment_count)


def single_answer(estimator: Estimator, dataset: Dataset) -> ContactAnswer:
    """What a single-contact model says of a dataset."""
    said = estimator.estimate_batch(dataset.tension_difference_n, dataset.command_rad)
    return ContactAnswer(
        segment=said.segment,
        angle_deg=said.angle_deg,
        magnitude_n=said.magnitude_n,
        magnitude_std_n=said.magnitude_std_n,
        angle_std_deg=said.angle_std_deg,
    )


def multi_figures(dataset: Dataset) -> dict[str, MultiContactMetrics]:
    """Metrics of the multi-contact models, contacts below `WEAKEST_MULTI_N` left out."""
    figures = {}
    for name, model in {"shipped": MULTI_MODEL, **MULTI_PEERS}.items():
        estimator = MultiEstimator.load(find_model(model), dataset.arm)
        said = estimator.estimate_batch(dataset.tension_difference_n, dataset.command_rad)
        figures[name] = multi_contact_metrics(
            dataset.contacts,
            dataset.magnitudes_n,
            said.probabilities > 0.5,
            said.magnitude_n,
            WEAKEST_MULTI_N,
        )
    return figures


def as_json(comparison: Comparison) -> dict[str, Any]:
    """The comparison as `cablesense evaluate --json` prints it."""
    settings = comparison.settings
    peers: dict[str, dict[str, Any]] = {}
    for figures in settings:
        for name, metrics in figures.peers.items():
            peers.setdefault(name, {})[figures.setting] = single_json(metrics)
    return {
        "seed": comparison.seed,
        "samples": comparison.samples,
        "single": {
            f.setting: {**single_json(f.shipped), "mae_over_bound": f.firm_ratio} for f in settings
        },
        "multi": {
            "recognition_accuracy": comparison.multi["shipped"].recognition_accuracy,
            "macro_f1": comparison.multi["shipped"].macro_f1,
            "magnitude_mae_n": list(comparison.multi["shipped"].magnitude_mae_n),
        },
        "bound": {f.setting: asdict(f.bound) for f in settings},
        "peers": peers,
        "coverage95": comparison.coverage95,
    }


def single_json(metrics: SingleContactMetrics) -> dict[str, Any]:
    """One model's figures in one setting; None where there was nothing to average."""
    errors = metrics.errors
    figures = {
        "contact_accuracy": metrics.contact_accuracy,
        "direction_mae_deg": errors.direction_mae_deg,
        "magnitude_mae_n": errors.magnitude_mae_n,
        "magnitude_rmse_n": errors.magnitude_rmse_n,
        "macro_f1": metrics.macro_f1,
        "coverage95": errors.magnitude_coverage95,
    }
    by_force = [_none_for_nan(force_bin) for force_bin in _bins(metrics)]
    return {**_none_for_nan(figures), "by_force": by_force}


def _none_for_nan(figures: dict[str, float]) -> dict[str, float | None]:
    """JSON has no NaN."""
    return {name: None if math.isnan(value) else value for name, value in figures.items()}


def _bins(metrics: SingleContactMetrics) -> Iterable[dict[str, float]]:
    for force_bin in metrics.bins:
        yield {
            "low_n": force_bin.low_n,
            "high_n": force_bin.high_n,
            "contacts": force_bin.errors.contacts,
            "contact_accuracy": force_bin.errors.contact_accuracy,
            "direction_mae_deg": force_bin.errors.direction_mae_deg,
            "magnitude_mae_n": force_bin.errors.magnitude_mae_n,
        }
