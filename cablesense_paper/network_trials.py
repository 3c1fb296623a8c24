"""Networks of many shapes, trained on the same samples, tested on the same others, and timed.

A `Plan` states which shapes are tried and on how much, `explore` carries it out, and
`TrialResults` answers what the trials show together.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from cablesense_base.workers import WorkerPool
from cablesense_sim.arm import Arm, open_arm
from cablesense_training.data.dataset import Dataset
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.protocols import Pose, SingleContact
from cablesense_training.evaluation.comparison import evaluate_answer
from cablesense_training.export import export_model
from cablesense_training.fit import FitSettings, fit
from cablesense_training.inference.metadata import ModelMetadata
from cablesense_training.inference.session import TENSION, open_session, read_model
from cablesense_training.model_training import single_contact_answer
from cablesense_training.networks import SingleContactNetwork
from cablesense_training.networks.single_contact import (
    DecoupledNetwork,
    SharedBackboneNetwork,
    TwoStageNetwork,
)

DECOUPLED, SHARED_TRUNK, TWO_STAGE = "decoupled", "shared trunk", "two-stage"
ARCHITECTURES = (DECOUPLED, SHARED_TRUNK, TWO_STAGE)
"""By the paper: three networks apart, one trunk for all, contact first and force given it."""


class Shape(NamedTuple):
    """A network: its architecture, and how deep and wide each of its trunks is.

    The first stage of two has a layer less than the second.
    """

    architecture: str
    depth: int
    width: int


PAPER_SHAPE = Shape(TWO_STAGE, 3, 128)
PAPER_SAMPLES, PAPER_BATCH_SIZE = 5_000, 64
"""The two-stage network that learns from the paper's amount of data, and that amount."""


@dataclass(frozen=True)
class Plan:
    """How much is tried.

    Attributes:
        depths, widths: of the decoupled networks, each with each.
        compared_depth: at which the three architectures are compared, over all widths.
        seeds: each shape is trained with all of them.
        samples, batch_size, epochs: of every training.
        test_samples: that all are tested on.
        paper_poses: at which a network also learns from the paper's amount of data.
        workers: most processes that train; there are no more than cores.
    """

    depths: Sequence[int]
    widths: Sequence[int]
    compared_depth: int
    seeds: Sequence[int]
    samples: int
    batch_size: int
    epochs: int
    test_samples: int
    paper_poses: Sequence[Pose]
    workers: int

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """All that are tried: decoupled networks first, each once."""
        others = (name for name in ARCHITECTURES if name != DECOUPLED)
        return (
            *(Shape(DECOUPLED, depth, width) for depth in self.depths for width in self.widths),
            *(Shape(name, self.compared_depth, width) for name in others for width in self.widths),
        )

    @property
    def compared(self) -> tuple[Shape, ...]:
        """Those of all architectures that have the compared depth."""
        return tuple(shape for shape in self.shapes if shape.depth == self.compared_depth)


@dataclass(frozen=True)
class Trial:
    """One shape, trained with one seed.

    Attributes:
        shape: which.
        seed: of the initial weights, the split and the order of the batches.
        parameters: trained numbers behind the answers.
        wrong_contact: share of the test samples answered with a wrong class.
        direction_mae_deg, magnitude_mae_n, magnitude_rmse_n: on the test samples.
    """

    shape: Shape
    seed: int
    parameters: int
    wrong_contact: float
    direction_mae_deg: float
    magnitude_mae_n: float
    magnitude_rmse_n: float


WRONG, DIRECTION, FORCE = "wrong, %", "direction MAE, °", "force MAE, N"
METRICS: dict[str, Callable[[Trial], float]] = {
    WRONG: lambda trial: 100.0 * trial.wrong_contact,
    DIRECTION: lambda trial: trial.direction_mae_deg,
    FORCE: lambda trial: trial.magnitude_mae_n,
}
"""Errors of a trial, by the names that tables and axes give them."""

PAPER_ERRORS = {WRONG: 2.0, DIRECTION: 5.96, FORCE: 9.97}
"""Of the paper's single-contact network."""


@dataclass(frozen=True)
class TrialResults:
    """Of one plan.

    Attributes:
        plan: what was tried.
        trials: of every shape and seed of the plan.
        cost_us: microseconds of one answer of the compared shapes.
        with_little_data: by pose, the network that learnt from the paper's amount of data.
    """

    plan: Plan
    trials: tuple[Trial, ...]
    cost_us: Mapping[Shape, float]
    with_little_data: Mapping[Pose, Trial]

    def errors(self, shape: Shape, metric: str) -> list[float]:
        """One of `METRICS` for every seed of a shape."""
        return [METRICS[metric](one) for one in self.trials if one.shape == shape]

    def mean(self, shape: Shape, metric: str) -> float:
        """One of `METRICS`, mean over the seeds."""
        return float(np.mean(self.errors(shape, metric)))

    def parameters(self, shape: Shape) -> int:
        """Trained numbers behind the answers of a shape."""
        return next(one.parameters for one in self.trials if one.shape == shape)

    def smallest_like_the_paper(self) -> Shape | None:
        """The decoupled shape of fewest parameters that is as good as the paper in all."""
        reached = [
            shape
            for shape in self.plan.shapes
            if shape.architecture == DECOUPLED
            and all(self.mean(shape, metric) <= most for metric, most in PAPER_ERRORS.items())
        ]
        return min(reached, key=self.parameters, default=None)

    def error_ratios(self, ours: str, theirs: str) -> dict[str, float]:
        """Errors of one architecture over those of another, by metric.

        Geometric means over the widths, at the compared depth.
        """
        pairs = self._pairs(ours, theirs)
        return {
            metric: _geometric_mean(self.mean(a, metric) / self.mean(b, metric) for a, b in pairs)
            for metric in METRICS
        }

    def parameter_ratio(self, ours: str, theirs: str) -> float:
        """Parameters of one architecture over those of another, likewise."""
        pairs = self._pairs(ours, theirs)
        return _geometric_mean(self.parameters(a) / self.parameters(b) for a, b in pairs)

    def cost_ratio(self, ours: str, theirs: str) -> float:
        """Time that answers of one architecture take over that of another, all widths together."""
        one, other = (
            np.mean([us for shape, us in self.cost_us.items() if shape.architecture == name])
            for name in (ours, theirs)
        )
        return float(one / other)

    def _pairs(self, ours: str, theirs: str) -> list[tuple[Shape, Shape]]:
        """Compared shapes of two architectures, by width."""
        compared = self.plan.compared
        return [(a, a._replace(architecture=theirs)) for a in compared if a.architecture == ours]


def _geometric_mean(ratios: Iterable[float]) -> float:
    return float(np.exp(np.mean(np.log(list(ratios)))))


_BUILDERS: dict[str, Callable[[int, int, list[int]], SingleContactNetwork]] = {
    DECOUPLED: DecoupledNetwork,
    SHARED_TRUNK: SharedBackboneNetwork,
    TWO_STAGE: lambda cables, segments, widths: TwoStageNetwork(
        cables, segments, widths[:-1] or widths, widths
    ),
}


def build(shape: Shape, arm: Arm, seed: int) -> SingleContactNetwork:
    """A network of that shape for an arm, with the initial weights that the seed gives."""
    widths = [shape.width] * shape.depth
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return _BUILDERS[shape.architecture](arm.cable_count, arm.segment_count, widths)


def parameter_count(network: SingleContactNetwork) -> int:
    """Trained numbers behind the answers; those that state the uncertainty do not count."""
    return sum(
        part.numel() for name, part in network.named_parameters() if not name.startswith("spread.")
    )


def trial(
    training: Dataset, test: Dataset, settings: FitSettings, shape: Shape, seed: int
) -> Trial:
    """Train and test; on one thread, so that the same seed gives the same metrics."""
    network = build(shape, training.arm, seed)
    fit(network, training, replace(settings, seed=seed, threads=1))
    answer = single_contact_answer(network.double(), test)
    metrics = evaluate_answer(answer, test).metrics
    return Trial(
        shape=shape,
        seed=seed,
        parameters=parameter_count(network),
        wrong_contact=1.0 - metrics.contact_accuracy,
        direction_mae_deg=metrics.errors.direction_mae_deg,
        magnitude_mae_n=metrics.errors.magnitude_mae_n,
        magnitude_rmse_n=metrics.errors.magnitude_rmse_n,
    )


_BLOCKS, _RUNS = 7, 300


def answer_us(shape: Shape, arm: Arm) -> float:
    """Microseconds that ONNX Runtime takes for one answer on one core: the best of some blocks.

    What a network has learnt does not change how long it takes, so an untrained one is timed.
    """
    metadata = ModelMetadata(
        kind="single-contact",
        network=shape.architecture,
        arm=arm,
        arm_identity=arm.identity,
        cable_names=arm.cable_names,
        joint_names=arm.joint_names,
        pose_aware=False,
        pose_range_deg=0.0,
        force_range_n=200.0,
        tare_samples=1,
        command="",
        seed=0,
        version="",
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "shape.onnx")
        export_model(build(shape, arm, 0), path, metadata)
        model, _ = read_model(path)
    session = open_session(model)
    inputs = {TENSION: np.linspace(-20.0, 30.0, arm.cable_count)[None]}
    took = []
    for _ in range(_BLOCKS):
        began = time.perf_counter()
        for _ in range(_RUNS):
            session.run(None, inputs)
        took.append((time.perf_counter() - began) / _RUNS)
    return 1e6 * min(took)


_TRAIN_SEED, _TEST_SEED = 0, 20_260_002


def explore(plan: Plan, progress: Callable[[float], None]) -> TrialResults:
    """Carry out a plan on the arm of the paper; all but microseconds come out the same again.

    Args:
        plan: what is tried.
        progress: receives the share that is done, up to 0.99.
    """
    arm = open_arm("cdsm")
    training, test = _datasets(arm, SingleContact(samples=plan.samples), plan.test_samples)
    cases = [(shape, seed) for shape in plan.shapes for seed in plan.seeds]
    settings = FitSettings(epochs=plan.epochs, batch_size=plan.batch_size)
    done: list[Trial] = []
    with WorkerPool(min(plan.workers, os.cpu_count() or 1), training, test, settings) as pool:
        for one in pool.map(trial, *zip(*cases, strict=True)):
            done.append(one)
            progress(0.7 * len(done) / len(cases))
    with_little_data = {pose: _with_little_data(plan, arm, pose) for pose in plan.paper_poses}
    progress(0.8)
    cost_us = {}
    for shape in plan.compared:
        cost_us[shape] = answer_us(shape, arm)
        progress(0.8 + 0.19 * len(cost_us) / len(plan.compared))
    return TrialResults(plan, tuple(done), cost_us, with_little_data)


def _with_little_data(plan: Plan, arm: Arm, pose: Pose) -> Trial:
    """A two-stage network on the paper's amount of data, tested as the paper tests."""
    protocol = SingleContact(
        samples=PAPER_SAMPLES, pose=pose, noise=False, no_contact_fraction=0.0
    )
    settings = FitSettings(epochs=2 * plan.epochs, batch_size=PAPER_BATCH_SIZE)
    training, test = _datasets(arm, protocol, plan.test_samples)
    return trial(training, test, settings, PAPER_SHAPE, 0)


def _datasets(arm: Arm, protocol: SingleContact, test_samples: int) -> tuple[Dataset, Dataset]:
    """To train on, and to test on."""
    return (
        draw_dataset(arm, protocol, _TRAIN_SEED),
        draw_dataset(arm, replace(protocol, samples=test_samples), _TEST_SEED),
    )
