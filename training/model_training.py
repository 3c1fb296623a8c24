"""Makes a model file of a network of the paper, with its errors on fresh data.

`RECIPES` has the networks by the names that commands and model files use.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import torch

from cablesense_base import Array
from cablesense_base.files import output_file
from cablesense_base.installation import package_version
from cablesense_base.progress import progress_bar
from cablesense_contact.inference.estimator import Estimates, Estimator, MultiEstimator
from cablesense_contact.inference.metadata import (
    MULTI_CONTACT,
    SINGLE_CONTACT,
    ModelKind,
    ModelMetadata,
    effect_versions,
    of_removed_network,
)
from cablesense_sim.arm import Arm
from cablesense_training.data.dataset import Dataset
from cablesense_training.data.generation import draw_dataset, generate
from cablesense_training.data.protocols import protocol_from_options
from cablesense_training.errors import TrainingError
from cablesense_training.evaluation.comparison import WEAKEST_MULTI_N, evaluate_estimator
from cablesense_training.evaluation.metrics import (
    ContactAnswer,
    multi_contact_metrics,
    plain_values,
)
from cablesense_training.export import export_model
from cablesense_training.fit import FitHistory, FitSettings, OnEpoch, fit, outputs_of
from cablesense_training.networks.layers import ContactNetwork
from cablesense_training.networks.learnt import (
    DecoupledNetwork,
    SharedBackboneNetwork,
    TwoStageMultiContactNetwork,
    TwoStageNetwork,
)

TEST_SAMPLES = 20_000
"""Of the test data of a training: errors are then known to 1 %."""
TEST_SEED_OFFSET = 1_000_000
"""Test data follow the protocol of the training data, with its seed plus this."""


@dataclass(frozen=True)
class Recipe:
    """How a network is trained unless chosen otherwise.

    Attributes:
        learns_from: kind of the protocol of its samples.
        build: makes it for an arm and the number of readings averaged into a tare.
        samples: how many of these to draw.
    """

    learns_from: Literal["single", "multi"]
    build: Callable[[Arm, int], ContactNetwork]
    samples: int = 100_000
    settings: FitSettings = field(default_factory=FitSettings)


RECIPES: dict[str, Recipe] = {
    "two-stage": Recipe("single", TwoStageNetwork.for_arm),
    "shared-backbone": Recipe("single", SharedBackboneNetwork.for_arm),
    "decoupled": Recipe("single", DecoupledNetwork.for_arm),
    "multi-contact": Recipe("multi", TwoStageMultiContactNetwork.for_arm),
}


def recipe_for(name: str) -> Recipe:
    """The recipe of a network.

    Raises:
        TrainingError: there is no network of that name; the message lists those there are.
    """
    if name == "anywhere":
        raise TrainingError(
            "network anywhere was the estimator of contacts anywhere; `cablesense export --arm` "
            "makes it now in seconds, without training"
        )
    removed = of_removed_network(name)
    if removed:
        raise TrainingError(removed)
    if name not in RECIPES:
        raise TrainingError(f"no network {name!r}; there are: {', '.join(RECIPES)}")
    return RECIPES[name]


def build_network(name: str, arm: Arm, seed: int = 0, tare_samples: int = 50) -> ContactNetwork:
    """A network for an arm with the initial weights that the seed gives; see `recipe_for`."""
    recipe = recipe_for(name)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return recipe.build(arm, tare_samples)


@dataclass(frozen=True)
class TrainingReport:
    """The result of a training run: the model file, the network's name, and how it was trained.

    Attributes:
        parameters: number of trained numbers.
        errors: on test data, as plain values: `single`; or `multi` and `multi_firm`, contacts
            below `WEAKEST_MULTI_N` left out.
    """

    path: Path
    network: str
    parameters: int
    history: FitHistory
    errors: dict[str, Any]

    def as_json(self) -> dict[str, Any]:
        """As plain values; NaN becomes None."""
        plain = {
            "out": str(self.path),
            "network": self.network,
            "parameters": self.parameters,
            "bytes": self.path.stat().st_size,
            "epochs": len(self.history.epochs),
            "best_epoch": self.history.best_epoch,
            "best_validation": self.history.best_validation,
            "training_seconds": self.history.seconds,
            **self.errors,
        }
        return dict(plain_values(plain))


def draw_training_data(
    arm: Arm, network: str, options: dict[str, Any], seed: int, *, show_progress: bool = False
) -> Dataset:
    """Fresh samples for a network.

    `options` are those of a protocol. None means the default, or the load that the arm bears if
    that is less.

    Raises:
        TrainingError: there is no such network.
        DatasetError: an option out of range, or one that the protocol does not have.
        WeakArmError: the arm cannot stand.
    """
    recipe = recipe_for(network)
    chosen = {name: value for name, value in options.items() if value is not None}
    protocol = protocol_from_options({"kind": recipe.learns_from, **chosen}, arm)
    parts = []
    with progress_bar(protocol.samples, shown=show_progress) as advance:
        for part in generate(arm, protocol, seed):
            parts.append(part)
            advance(len(part))
    return Dataset.concatenate(parts)


def train_model(
    path: str | Path,
    network: str,
    data: Dataset,
    settings: FitSettings,
    *,
    command: str,
    test_samples: int | None = None,
    on_epoch: OnEpoch | None = None,
) -> TrainingReport:
    """Train a network and write the model file; nothing is written when anything fails.

    Args:
        path: of the file.
        network: its name.
        data: what to train on; its arm is the model's arm.
        settings: how to train; the seed also fixes the initial weights.
        command: what makes the file again, kept in it.
        test_samples: size of the test set, drawn afresh by the data's own protocol; None means
            `TEST_SAMPLES`.
        on_epoch: called after every epoch.

    Raises:
        TrainingError: unknown network, data or settings that do not fit it, a place that cannot
            be written to, or a loss that is not finite.
    """
    path = Path(path)
    recipe = recipe_for(network)
    follows = data.protocol.kind
    if follows != recipe.learns_from:
        raise TrainingError(
            f"network {network} is for protocol {recipe.learns_from}; the data follow {follows} "
            f"(cablesense dataset --protocol {recipe.learns_from})"
        )
    output_file(path, TrainingError, force=True)
    built = build_network(network, data.arm, settings.seed, data.protocol.tare_samples)
    parameters = sum(part.numel() for part in built.parameters())
    history = fit(built, data, settings, on_epoch)
    metadata = _metadata(network, built, data, settings.seed, command)
    export_model(built.double(), path, metadata)
    protocol = replace(data.protocol, samples=test_samples or TEST_SAMPLES)
    test = draw_dataset(data.arm, protocol, data.seed + TEST_SEED_OFFSET)
    return TrainingReport(
        path, network, parameters, history, _sample_errors(path, metadata.kind, test)
    )


def _sample_errors(path: Path, kind: ModelKind, test: Dataset) -> dict[str, Any]:
    """The errors of a `TrainingReport`, of the model in a file on samples."""
    if kind == SINGLE_CONTACT:
        metrics = evaluate_estimator(Estimator.load(path), test).metrics
        return {"single": asdict(metrics) | {"coverage95": metrics.coverage95}}
    estimates = MultiEstimator.load(path).estimate_batch(
        test.tension_difference_n, test.command_rad
    )
    judged = test.contacts, test.magnitudes_n, estimates.probabilities > 0.5, estimates.magnitude_n
    return {
        "multi": asdict(multi_contact_metrics(*judged)),
        "multi_firm": asdict(multi_contact_metrics(*judged, WEAKEST_MULTI_N)),
    }


def _metadata(
    name: str, network: ContactNetwork, data: Dataset, seed: int, command: str
) -> ModelMetadata:
    arm = data.arm
    protocol = data.protocol
    return ModelMetadata(
        kind=MULTI_CONTACT if network.several else SINGLE_CONTACT,
        network=name,
        arm=arm,
        arm_identity=arm.identity,
        cable_names=arm.cable_names,
        joint_names=arm.joint_names,
        pose_aware=network.pose_aware,
        pose_range_deg=0.0 if protocol.pose == "straight" else protocol.pose_range_deg,
        force_range_n=protocol.force_high_n,
        tare_samples=protocol.tare_samples,
        effect_versions=effect_versions(arm),
        command=command,
        seed=seed,
        version=package_version(),
    )


def contact_answer(
    network: ContactNetwork, tension_difference_n: Array, command_rad: Array
) -> ContactAnswer:
    """A single-contact network's answers on B samples, (B, M) and (B, 2N); angles in [0, 360)."""
    outputs = outputs_of(network, tension_difference_n, command_rad)
    return ContactAnswer.of(Estimates.of_outputs([part.numpy() for part in outputs]))
