"""From a dataset to a model file with its figures: train, test on fresh samples, export.

What a network is trained on: a dataset file, or fresh samples of the protocol that suits it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from cablesense_base.progress import progress_bar
from cablesense_sim.arm import Arm
from cablesense_training.data.dataset import Dataset
from cablesense_training.data.generation import draw_dataset, generate
from cablesense_training.data.parquet import read_dataset
from cablesense_training.data.protocols import MultiContact, SingleContact, protocol_from_options
from cablesense_training.errors import TrainingError
from cablesense_training.evaluation.answers import (
    multi_contact_answer,
    single_contact_answer,
    single_contact_truth,
)
from cablesense_training.evaluation.metrics import (
    MultiContactMetrics,
    SingleContactMetrics,
    multi_contact_metrics,
    single_contact_metrics,
)
from cablesense_training.export import export_model
from cablesense_training.fit import EpochRecord, FitHistory, FitSettings, fit
from cablesense_training.inference.metadata import ModelMetadata
from cablesense_training.networks import MultiContactNetwork, Network
from cablesense_training.recipes import build_network

TEST_SAMPLES = 20_000
TEST_SEED_OFFSET = 1_000_000
"""The test set follows the training set's protocol, with its seed plus this."""

WEAKEST_JUDGED_N = 5.0
"""Multi-contact recognition is also reported for contacts of at least this force."""


@dataclass(frozen=True)
class TrainingReport:
    """What came of a training run.

    Attributes:
        path: the model file.
        network: its network's name.
        parameters: number of trained numbers.
        history: losses epoch by epoch.
        single: figures on the test set, of a single-contact network.
        multi: the same of a multi-contact network, all contacts counted.
        multi_firm: the same, contacts below `WEAKEST_JUDGED_N` left out.
    """

    path: Path
    network: str
    parameters: int
    history: FitHistory
    single: SingleContactMetrics | None
    multi: MultiContactMetrics | None
    multi_firm: MultiContactMetrics | None

    def figures(self) -> dict[str, Any]:
        """As plain values; what does not apply to the network is left out, NaN becomes None."""
        plain: dict[str, Any] = {
            "out": str(self.path),
            "network": self.network,
            "parameters": self.parameters,
            "bytes": self.path.stat().st_size,
            "epochs": len(self.history.epochs),
            "best_epoch": self.history.best_epoch,
            "best_validation": self.history.best_validation,
            "training_seconds": self.history.seconds,
        }
        for name in ("single", "multi", "multi_firm"):
            metrics = getattr(self, name)
            if metrics is not None:
                plain[name] = _without_nan(asdict(metrics))
        if self.single is not None:
            plain["single"]["coverage95"] = self.single.coverage95
        return plain


def train_model(
    path: str | Path,
    network_name: str,
    dataset: Dataset,
    settings: FitSettings,
    *,
    command: str,
    test_samples: int | None = None,
    on_epoch: Callable[[EpochRecord], None] | None = None,
) -> TrainingReport:
    """Train the named network on a dataset and write it as a model file.

    Args:
        path: the ONNX file to write.
        network_name: one of `networks.registry.NETWORKS`.
        dataset: what to train on; its arm is the model's arm.
        settings: how to train; the seed also fixes the initial weights.
        command: what makes the file again, kept in it.
        test_samples: size of the test set, drawn afresh by the dataset's own protocol; None stands
            for `TEST_SAMPLES`.
        on_epoch: called after every epoch.

    Raises:
        TrainingError: unknown network, or data that does not fit it; nothing is written then.
    """
    network = build_network(network_name, dataset.arm, settings.seed)
    _require_protocol(network_name, network, dataset)
    _require_folder(Path(path))
    history = fit(network, dataset, settings, on_epoch)
    network.double()
    protocol = replace(dataset.protocol, samples=test_samples or TEST_SAMPLES)
    test = draw_dataset(dataset.arm, protocol, dataset.seed + TEST_SEED_OFFSET)
    single, multi, firm = _figures(network, test)
    export_model(network, Path(path), _metadata(network_name, network, dataset, settings, command))
    return TrainingReport(
        path=Path(path),
        network=network_name,
        parameters=sum(p.numel() for p in network.parameters() if p.requires_grad),
        history=history,
        single=single,
        multi=multi,
        multi_firm=firm,
    )


def _figures(
    network: Network, test: Dataset
) -> tuple[SingleContactMetrics | None, MultiContactMetrics | None, MultiContactMetrics | None]:
    if isinstance(network, MultiContactNetwork):
        touched, magnitude = multi_contact_answer(network, test)
        every, firm = (
            multi_contact_metrics(test.contacts, test.magnitudes_n, touched, magnitude, weakest)
            for weakest in (0.0, WEAKEST_JUDGED_N)
        )
        return None, every, firm
    answer = single_contact_answer(network, test)
    truth = single_contact_truth(test)
    return single_contact_metrics(truth, answer, test.arm.segment_count), None, None


def _metadata(
    name: str, network: Network, dataset: Dataset, settings: FitSettings, command: str
) -> ModelMetadata:
    arm, protocol = dataset.arm, dataset.protocol
    return ModelMetadata(
        kind="multi-contact" if isinstance(network, MultiContactNetwork) else "single-contact",
        network=name,
        arm=arm,
        arm_identity=arm.identity,
        cable_names=arm.cable_names,
        joint_names=arm.joint_names,
        pose_aware=network.pose_aware,
        pose_range_deg=protocol.pose_range_deg if protocol.pose == "random" else 0.0,
        force_range_n=protocol.force_high_n,
        tare_samples=protocol.tare_samples,
        command=command,
        seed=settings.seed,
        version=_version(),
    )


def _require_protocol(name: str, network: Network, dataset: Dataset) -> None:
    wanted = MultiContact if isinstance(network, MultiContactNetwork) else SingleContact
    if not isinstance(dataset.protocol, wanted):
        raise TrainingError(
            f"network {name} is for protocol {wanted.kind}; the dataset follows "
            f"{dataset.protocol.kind} (cablesense dataset --protocol {wanted.kind})"
        )


def _require_folder(path: Path) -> None:
    """Better before an hour of training than after it."""
    if not path.parent.is_dir():
        raise TrainingError(f"{path}: there is no folder {path.parent}; make it first")
    if path.is_dir():
        raise TrainingError(f"{path} is a folder; give the name of the file to write")


def _version() -> str:
    try:
        return version("cablesense_ros")
    except PackageNotFoundError:
        return "uninstalled"


def _without_nan(value: Any) -> Any:
    """JSON has no NaN."""
    if isinstance(value, dict):
        return {key: _without_nan(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(part) for part in value]
    return None if isinstance(value, float) and math.isnan(value) else value


def protocol_kind(network_name: str) -> str:
    """Kind of the protocol that a network learns from."""
    return "multi" if network_name.startswith("multi-contact") else "single"


def read_samples(path: Path, arm: Arm) -> Dataset:
    """A dataset file of that arm.

    Raises:
        DatasetError: not a dataset, or one of another arm.
    """
    return read_dataset(path, arm)


def draw_samples(
    arm: Arm,
    network_name: str,
    options: dict[str, Any],
    seed: int,
    *,
    workers: int = 1,
    show_progress: bool = False,
) -> Dataset:
    """Fresh samples for a network; `options` are the protocol's, None standing for its default.

    Raises:
        DatasetError: an option out of range.
    """
    given = {name: value for name, value in options.items() if value is not None}
    protocol = protocol_from_options({"kind": protocol_kind(network_name), **given})
    parts = []
    with progress_bar(protocol.samples, shown=show_progress) as advance:
        for part in generate(arm, protocol, seed, workers=workers):
            parts.append(part)
            advance(len(part))
    return Dataset.concatenate(parts)
