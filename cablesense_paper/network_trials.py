"""Shapes trained on the same samples, tested on the same others.

The shapes of networks that are tried.

Networks of the shapes that are tried.

Which shapes are tried, and on how much.

How long a network takes for one answer.

A plan, carried out: every shape trained on the same samples, tested, and timed.

What trials of many shapes say together.

Errors of networks against depth, width, parameters and time, as pictures.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from cablesense_base.workers import WorkerPool
from cablesense_gap.report.style import WIDTH_IN, plain_log_ticks
from cablesense_paper.network_findings import (
    DECOUPLED,
    FORCE,
    METRICS,
    PAPER_BATCH_SIZE,
    PAPER_FIGURES,
    PAPER_SAMPLES,
    PAPER_SHAPE,
    SHARED_TRUNK,
    TWO_STAGE,
    Findings,
    Plan,
    Shape,
)
from cablesense_paper.study import (
    BLACK,
    BLUE,
    DASHES,
    GREEN,
    ORANGE,
    SERIES,
    Picture,
    Tell,
    picture,
)
from cablesense_sim.arm import Arm, open_arm
from cablesense_training.data.dataset import Dataset
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.protocols import Pose, SingleContact
from cablesense_training.evaluation.answers import single_contact_answer, single_contact_truth
from cablesense_training.evaluation.metrics import single_contact_metrics
from cablesense_training.export import export_model
from cablesense_training.fit import FitSettings, fit
from cablesense_training.inference.metadata import ModelMetadata
from cablesense_training.inference.session import TENSION, open_session, read_model
from cablesense_training.networks import SingleContactNetwork
from cablesense_training.networks.single_contact import (
    DecoupledNetwork,
    SharedBackboneNetwork,
    TwoStageNetwork,
)

_BUILDERS: dict[str, Callable[[int, int, list[int]], SingleContactNetwork]] = {
    DECOUPLED: lambda cables, segments, widths: DecoupledNetwork(cables, segments, widths),
    SHARED_TRUNK: lambda cables, segments, widths: SharedBackboneNetwork(cables, segments, widths),
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


def parameters(network: SingleContactNetwork) -> int:
    """Trained numbers behind the answers; those that state the uncertainty do not count."""
    return sum(
        part.numel() for name, part in network.named_parameters() if not name.startswith("spread.")
    )


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


def trial(
    shape: Shape, seed: int, training: Dataset, test: Dataset, settings: FitSettings
) -> Trial:
    """Train and test; on one thread, so that the same seed gives the same figures."""
    network = build(shape, training.arm, seed)
    fit(network, training, replace(settings, seed=seed, threads=1))
    answer = single_contact_answer(network.double(), test)
    truth = single_contact_truth(test)
    metrics = single_contact_metrics(truth, answer, test.arm.segment_count)
    return Trial(
        shape=shape,
        seed=seed,
        parameters=parameters(network),
        wrong_contact=1.0 - metrics.contact_accuracy,
        direction_mae_deg=metrics.errors.direction_mae_deg,
        magnitude_mae_n=metrics.errors.magnitude_mae_n,
        magnitude_rmse_n=metrics.errors.magnitude_rmse_n,
    )


def trials(
    cases: Sequence[tuple[Shape, int]],
    training: Dataset,
    test: Dataset,
    settings: FitSettings,
    workers: int,
) -> Iterator[Trial]:
    """A trial for every shape and seed, in order; the same for any number of workers."""
    with WorkerPool(workers, training, test, settings) as pool:
        yield from pool.map(_trial_of_case, cases)


def _trial_of_case(
    training: Dataset, test: Dataset, settings: FitSettings, case: tuple[Shape, int]
) -> Trial:
    return trial(*case, training, test, settings)


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


def explore(plan: Plan, tell: Tell) -> Findings:
    """What the plan finds on the arm of the paper; all but microseconds come out the same again.

    Args:
        plan: what is tried.
        tell: hears which share is done, up to 0.99.
    """
    arm = open_arm("cdsm")
    done: list[Trial] = []
    for one in _tried(plan, arm):
        done.append(one)
        tell(0.7 * len(done) / (len(plan.shapes) * len(plan.seeds)))
    with_little_data = {pose: _with_little_data(plan, arm, pose) for pose in plan.paper_poses}
    tell(0.8)
    cost_us = {}
    for shape in plan.compared:
        cost_us[shape] = answer_us(shape, arm)
        tell(0.8 + 0.19 * len(cost_us) / len(plan.compared))
    return Findings(plan, tuple(done), cost_us, with_little_data)


def _tried(plan: Plan, arm: Arm) -> Iterator[Trial]:
    """Trials of all shapes and seeds on the straight arm, as each is done."""
    training, test = (
        draw_dataset(arm, SingleContact(samples=samples), seed)
        for samples, seed in ((plan.samples, _TRAIN_SEED), (plan.test_samples, _TEST_SEED))
    )
    cases = [(shape, seed) for shape in plan.shapes for seed in plan.seeds]
    settings = FitSettings(epochs=plan.epochs, batch_size=plan.batch_size)
    return trials(cases, training, test, settings, plan.workers)


def _with_little_data(plan: Plan, arm: Arm, pose: Pose) -> Trial:
    """A two-stage network on the paper's amount of data, tested as the paper tests."""
    training, test = (
        draw_dataset(
            arm,
            SingleContact(samples=samples, pose=pose, noise=False, no_contact_fraction=0.0),
            seed,
        )
        for samples, seed in ((PAPER_SAMPLES, _TRAIN_SEED), (plan.test_samples, _TEST_SEED))
    )
    settings = FitSettings(epochs=2 * plan.epochs, batch_size=PAPER_BATCH_SIZE)
    return trial(PAPER_SHAPE, 0, training, test, settings)


_STYLES = {
    DECOUPLED: (BLUE, "o", DASHES[0]),
    SHARED_TRUNK: (ORANGE, "s", DASHES[1]),
    TWO_STAGE: (GREEN, "D", DASHES[2]),
}


def depth_picture(findings: Findings) -> Picture:
    """Errors of the decoupled networks against width, a line for each depth."""
    plan = findings.plan
    figure, every = _panels()
    for axes, metric in zip(every, METRICS, strict=True):
        for n, depth in enumerate(plan.depths):
            shapes = [Shape(DECOUPLED, depth, width) for width in plan.widths]
            _curve(
                axes, plan.widths, shapes, findings, metric,
                color=SERIES[n % len(SERIES)], marker="osD^v"[n % 5], ls=DASHES[n % len(DASHES)],
                label=f"{depth} layer{'s' if depth > 1 else ''}" if axes is every[0] else "",
            )  # fmt: skip
        axes.set(xscale="log", xlabel="width of every layer", xticks=plan.widths)
        axes.set_xticks((), minor=True)
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    every[0].plot([], [], color=BLACK, ls="--", lw=1.0, label="the paper’s figure")
    figure.legend(loc="outside upper center", ncols=1 + len(plan.depths))
    return picture(
        "networks_depth_and_width",
        figure,
        "Section III-C: decoupled networks of several depths and widths. Lines: means over the "
        "seeds, which are the faint dots. Dashed: what the paper’s network reaches.",
        "Errors of decoupled networks against width for several depths, in three panels",
    )


def compared_picture(findings: Findings) -> Picture:
    """Errors of the three architectures against their number of parameters."""
    plan = findings.plan
    figure, every = _panels()
    for axes, metric in zip(every, METRICS, strict=True):
        for architecture, (colour, mark, dashes) in _STYLES.items():
            shapes = [shape for shape in plan.compared if shape.architecture == architecture]
            _curve(
                axes, [findings.parameters(shape) for shape in shapes], shapes, findings, metric,
                color=colour, marker=mark, ls=dashes,
                label=architecture if axes is every[0] else "",
            )  # fmt: skip
        axes.set(xscale="log", xlabel="thousand parameters (logarithmic)")
        plain_log_ticks(axes.xaxis)
        axes.xaxis.set_major_formatter(lambda value, _: f"{value / 1e3:g}")
    figure.legend(loc="outside upper center", ncols=3)
    return picture(
        "networks_architectures",
        figure,
        f"Section III-C: three networks apart, one trunk for all, and two stages, of "
        f"{plan.compared_depth} layers and widths from {min(plan.widths)} to {max(plan.widths)}, "
        "against their number of parameters. Dashed: what the paper’s network reaches.",
        "Errors of three architectures against parameters, in three panels",
    )


def cost_picture(findings: Findings) -> Picture:
    """Force error of the three architectures against the time of one answer."""
    import matplotlib.pyplot as plt

    cost_us = findings.cost_us
    figure, axes = plt.subplots(figsize=(0.72 * WIDTH_IN, 3.6), layout="constrained")
    for architecture, (colour, mark, dashes) in _STYLES.items():
        shapes = [shape for shape in cost_us if shape.architecture == architecture]
        x = [cost_us[shape] for shape in shapes]
        y = [findings.mean(shape, FORCE) for shape in shapes]
        axes.plot(x, y, mark, ls=dashes, color=colour, lw=1.4, ms=7, label=architecture)
        for shape, at_us, error_n in zip(shapes, x, y, strict=True):
            axes.annotate(
                str(shape.width), (at_us, error_n), xytext=(5, 5), textcoords="offset points",
                fontsize=8, color=colour,
            )  # fmt: skip
    axes.set(
        xlabel="one answer in ONNX Runtime, µs", ylabel="force MAE, N (logarithmic)", yscale="log"
    )
    plain_log_ticks(axes.yaxis)
    axes.set_xlim(0.0, None)
    axes.grid()
    figure.legend(loc="outside right center")
    return picture(
        "networks_cost",
        figure,
        f"Section III-C: cost against accuracy at {findings.plan.compared_depth} layers; the "
        "numbers are widths.",
        "Force error against the time of one answer for three architectures",
    )


def _panels() -> tuple[Any, Any]:
    """A figure of one panel for each metric, with the paper's figure in it."""
    import matplotlib.pyplot as plt

    figure, every = plt.subplots(
        1, len(METRICS), figsize=(WIDTH_IN, 3.5), layout="constrained", squeeze=False
    )
    for axes, metric in zip(every[0], METRICS, strict=True):
        axes.axhline(PAPER_FIGURES[metric], color=BLACK, ls="--", lw=1.0)
        axes.set(yscale="log", ylabel=f"{metric} (logarithmic)".replace("wrong,", "wrong class,"))
        plain_log_ticks(axes.yaxis)
        axes.grid()
    return figure, every[0]


def _curve(
    axes: Any, x: Sequence[float], shapes: Sequence[Shape], findings: Findings, metric: str,
    **style: Any,
) -> None:  # fmt: skip
    """Means over the seeds as a line, each seed as a faint dot."""
    axes.plot(x, [findings.mean(shape, metric) for shape in shapes], lw=1.6, ms=6, **style)
    for at, shape in zip(x, shapes, strict=True):
        for error in findings.errors(shape, metric):
            axes.plot(at, error, ".", color=style["color"], ms=4, alpha=0.45)
