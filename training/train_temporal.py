"""From an arm to a model file with memory: draw sequences, train, test on fresh ones, export."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from cablesense_base.installation import package_version
from cablesense_sim.arm import Arm
from cablesense_training.errors import TrainingError
from cablesense_training.evaluation.sequence_figures import (
    CourseFigures,
    course_answer,
    course_figures,
)
from cablesense_training.export import export_model
from cablesense_training.fit import EpochRecord, FitHistory
from cablesense_training.fit_sequences import SequenceFitSettings, fit_sequences
from cablesense_training.inference.metadata import COURSE_UNITS, ModelMetadata
from cablesense_training.inference.temporal_estimator import TemporalEstimator
from cablesense_training.motion.motion_protocol import MotionProtocol
from cablesense_training.motion.sequences import Sequences, draw_sequences
from cablesense_training.networks.temporal import TemporalNetwork

TEMPORAL_NETWORKS = {"temporal": True, "momentary": False}
"""Networks that learn from sequences, and whether they remember; the other is the peer."""

TEST_SHARE = 0.125
TEST_SEED_OFFSET = 1_000_000
"""Test sequences follow the training protocol, with its seed plus this."""


@dataclass(frozen=True)
class TemporalReport:
    """What came of a training run.

    Attributes:
        path: the model file.
        network: its network's name.
        parameters: number of trained numbers.
        sequences, test_sequences: how many it was trained and tested on.
        history: losses epoch by epoch.
        figures: of the file, on the test sequences.
    """

    path: Path
    network: str
    parameters: int
    sequences: int
    test_sequences: int
    history: FitHistory
    figures: CourseFigures


def train_temporal(
    path: Path,
    network_name: str,
    training: Sequences,
    test: Sequences,
    settings: SequenceFitSettings,
    *,
    command: str,
    on_epoch: Callable[[EpochRecord], None] | None = None,
) -> TemporalReport:
    """Train on sequences, write the model file, and judge the file on other sequences.

    Raises:
        TrainingError: an unknown network, no such folder, or a loss that is not finite.
    """
    if network_name not in TEMPORAL_NETWORKS:
        raise TrainingError(
            f"no network {network_name!r} learns from sequences; there are: "
            f"{', '.join(TEMPORAL_NETWORKS)}"
        )
    if not path.parent.is_dir():
        raise TrainingError(f"{path}: there is no folder {path.parent}; make it first")
    protocol = training.protocol
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(settings.seed)
        network = TemporalNetwork.for_arm(
            training.arm, protocol.tare_samples, remembers=TEMPORAL_NETWORKS[network_name]
        )
    history = fit_sequences(network, training, settings, on_epoch)
    export_model(network, path, _metadata(network_name, network, training, settings.seed, command))
    estimator = TemporalEstimator.load(path, training.arm)
    return TemporalReport(
        path=path,
        network=network_name,
        parameters=sum(part.numel() for part in network.parameters()),
        sequences=len(training),
        test_sequences=len(test),
        history=history,
        figures=course_figures(course_answer(estimator, test), test),
    )


def training_and_test(
    arm: Arm,
    protocol: MotionProtocol,
    seed: int,
    *,
    workers: int = 1,
    on_done: Callable[[int], None] | None = None,
) -> tuple[Sequences, Sequences]:
    """Sequences to train on, and others to test on; `on_done` is told of each lot's size.

    Raises:
        DatasetError: the arm finds no rest in any of them.
    """
    training = draw_sequences(arm, protocol, seed, workers=workers, on_done=on_done)
    fewer = replace(protocol, sequences=count_of_test(protocol))
    test = draw_sequences(arm, fewer, seed + TEST_SEED_OFFSET, workers=workers, on_done=on_done)
    return training, test


def count_of_test(protocol: MotionProtocol) -> int:
    """How many sequences are drawn for the test."""
    return max(1, round(TEST_SHARE * protocol.sequences))


def _metadata(
    name: str, network: TemporalNetwork, sequences: Sequences, seed: int, command: str
) -> ModelMetadata:
    arm, protocol = sequences.arm, sequences.protocol
    return ModelMetadata(
        kind="single-contact",
        network=name,
        arm=arm,
        arm_identity=arm.identity,
        cable_names=arm.cable_names,
        joint_names=arm.joint_names,
        units=dict(COURSE_UNITS),
        pose_aware=True,
        pose_range_deg=protocol.pose_range_deg,
        force_range_n=protocol.force_high_n,
        tare_samples=protocol.tare_samples,
        memory=network.memory,
        hidden=network.hidden,
        tick_s=protocol.tick_s,
        joint_speed_deg_s=protocol.joint_speed_deg_s,
        command=command,
        seed=seed,
        version=package_version(),
    )
