"""Networks of many shapes, trained on the same samples, tested on the same others, and timed.

A `Plan` states which shapes are tried and on how much, `explore` carries it out, and
`TrialResults` compares what came out.
"""

from __future__ import annotations

import os
import tempfile
import timeit
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import torch
from scipy.stats import gmean

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

WRONG, DIRECTION, FORCE = "wrong, %", "direction MAE, °", "force MAE, N"
FORCE_RMSE, PARAMETERS = "force RMSE, N", "parameters"
PAPER_ERRORS = {WRONG: 2.0, DIRECTION: 5.96, FORCE: 9.97}
"""Of the paper's single-contact network, by the names that tables and axes give them."""

Trial = dict[str, Any]
"""One shape, trained with one seed: both, its `PARAMETERS` and its errors on the test samples."""


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


@dataclass(frozen=True, eq=False)
class TrialResults:
    """All trials of a plan, and microseconds of one answer of the compared shapes.

    `with_little_data` are the networks that learnt from the paper's amount of data, by pose.
    """

    plan: Plan
    done: Sequence[Trial]
    cost_us: Mapping[Shape, float]
    with_little_data: Mapping[Pose, Trial]

    @cached_property
    def trials(self) -> pd.DataFrame:
        """A row for every trial; the index is its shape."""
        return pd.DataFrame(self.done).set_index(list(Shape._fields))

    @cached_property
    def means(self) -> pd.DataFrame:
        """Errors and parameters, mean over the seeds, by shape."""
        return (
            self.trials.drop(columns="seed").groupby(level=list(Shape._fields), sort=False).mean()
        )

    def smallest_like_the_paper(self) -> Shape | None:
        """The decoupled shape of fewest parameters that is as good as the paper in all."""
        decoupled = self.means.xs(DECOUPLED, drop_level=False)
        good = decoupled[list(PAPER_ERRORS)] <= list(PAPER_ERRORS.values())
        reached = decoupled[good.all(axis=1)]
        return None if reached.empty else Shape(*reached[PARAMETERS].idxmin())

    def ratios(self, ours: str, theirs: str) -> dict[str, float]:
        """Errors and `PARAMETERS` of one architecture over those of another.

        Geometric means over the widths, at the compared depth.
        """
        one, other = (self.means.loc[name, self.plan.compared_depth] for name in (ours, theirs))
        return dict(zip(one.columns, gmean(one / other).tolist(), strict=True))

    def cost_ratio(self, ours: str, theirs: str) -> float:
        """Time that answers of one architecture take over that of another, all widths together."""
        one, other = (
            np.mean([us for shape, us in self.cost_us.items() if shape.architecture == name])
            for name in (ours, theirs)
        )
        return float(one / other)


def build(shape: Shape, arm: Arm, seed: int) -> SingleContactNetwork:
    """A network of that shape for an arm, with the initial weights that the seed gives."""
    inputs, widths = (arm.cable_count, arm.segment_count), [shape.width] * shape.depth
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        if shape.architecture == TWO_STAGE:
            return TwoStageNetwork(*inputs, widths[:-1] or widths, widths)
        decoupled = shape.architecture == DECOUPLED
        return (DecoupledNetwork if decoupled else SharedBackboneNetwork)(*inputs, widths)


def parameter_count(network: SingleContactNetwork) -> int:
    """Trained numbers behind the answers; those that state the uncertainty do not count."""
    return sum(
        part.numel() for name, part in network.named_parameters() if not name.startswith("spread.")
    )


def trial(
    training: Dataset, test: Dataset, settings: FitSettings, shape: Shape, seed: int
) -> Trial:
    """Train and test; on one thread, so that the same seed gives the same metrics.

    The seed is that of the initial weights, the split and the order of the batches.
    """
    network = build(shape, training.arm, seed)
    fit(network, training, replace(settings, seed=seed, threads=1))
    metrics = evaluate_answer(single_contact_answer(network.double(), test), test).metrics
    return {
        **shape._asdict(),
        "seed": seed,
        PARAMETERS: parameter_count(network),
        WRONG: 100.0 * (1.0 - metrics.contact_accuracy),
        DIRECTION: metrics.errors.direction_mae_deg,
        FORCE: metrics.errors.magnitude_mae_n,
        FORCE_RMSE: metrics.errors.magnitude_rmse_n,
    }


_BLOCKS, _RUNS = 7, 300


def answer_us(shape: Shape, arm: Arm) -> float:
    """Microseconds that ONNX Runtime takes for one answer on one core: the best of some blocks.

    What a network has learnt does not change how long it takes, so an untrained one is timed.
    """
    metadata = ModelMetadata(
        kind="single-contact", network=shape.architecture, arm=arm, arm_identity=arm.identity,
        cable_names=arm.cable_names, joint_names=arm.joint_names, pose_aware=False,
        pose_range_deg=0.0, force_range_n=200.0, tare_samples=1, command="", seed=0, version="",
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "shape.onnx")
        export_model(build(shape, arm, 0), path, metadata)
        model, _ = read_model(path)
    session = open_session(model)
    inputs = {TENSION: np.linspace(-20.0, 30.0, arm.cable_count)[None]}
    took_s = timeit.repeat(lambda: session.run(None, inputs), repeat=_BLOCKS, number=_RUNS)
    return 1e6 * min(took_s) / _RUNS


def explore(plan: Plan, progress: Callable[[float], None]) -> TrialResults:
    """Carry out a plan on the arm of the paper; all but microseconds come out the same again.

    `progress` receives the share that is done, up to 0.99.
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
    with_little_data = {}
    for pose in plan.paper_poses:
        protocol = SingleContact(
            samples=PAPER_SAMPLES, pose=pose, noise=False, no_contact_fraction=0.0
        )
        like_paper = FitSettings(epochs=2 * plan.epochs, batch_size=PAPER_BATCH_SIZE)
        few = _datasets(arm, protocol, plan.test_samples)
        with_little_data[pose] = trial(*few, like_paper, PAPER_SHAPE, 0)
    progress(0.8)
    cost_us = {}
    for shape in plan.compared:
        cost_us[shape] = answer_us(shape, arm)
        progress(0.8 + 0.19 * len(cost_us) / len(plan.compared))
    return TrialResults(plan, done, cost_us, with_little_data)


def _datasets(arm: Arm, protocol: SingleContact, test_samples: int) -> tuple[Dataset, Dataset]:
    """To train on, and to test on."""
    test = replace(protocol, samples=test_samples)
    return draw_dataset(arm, protocol, seed=0), draw_dataset(arm, test, seed=20_260_002)
