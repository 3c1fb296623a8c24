"""Section III-C: depth and width of networks, shared or separate trunks.

Networks of many shapes are trained on the same samples and tested on the same others. A `Plan`
states which shapes are tried and on how much, `explore` carries it out, and `TrialResults`
compares what came out.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import pandas as pd
import torch
from scipy.stats import gmean

from cablesense_base.workers import WorkerPool
from cablesense_sim.arm import Arm, open_arm
from cablesense_training.data.dataset import Dataset
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.protocols import Pose, SingleContact
from cablesense_training.evaluation.comparison import evaluate_answer
from cablesense_training.fit import FitSettings, fit
from cablesense_training.model_training import contact_answer
from cablesense_training.networks.layers import ContactNetwork
from cablesense_training.networks.learnt import (
    DecoupledNetwork,
    SharedBackboneNetwork,
    TwoStageNetwork,
)
from paper.drawing import (
    BLACK,
    BLUE,
    DASHES,
    GREEN,
    ORANGE,
    SERIES,
    panels,
    plain_log_ticks,
    plain_ticks,
)
from paper.study import Figures, Numbers, Progress

DECOUPLED = "decoupled"
SHARED_TRUNK = "shared trunk"
TWO_STAGE = "two-stage"
"""By the paper: three separate networks, one trunk for all, contact first and force given it."""
PAPER_SAMPLES = 5_000
PAPER_BATCH_SIZE = 64
WRONG = "wrong, %"
DIRECTION = "direction MAE, °"
FORCE = "force MAE, N"
FORCE_RMSE = "force RMSE, N"
PARAMETERS = "parameters"
PAPER_ERRORS = {WRONG: 2.0, DIRECTION: 5.96, FORCE: 9.97}
"""The errors of the paper's single-contact network, by their names in tables and axes."""

_POSES = {"straight": "straight arm", "random": "poses within ±10°, unknown"}
_STYLES: dict[str, dict[str, Any]] = {
    DECOUPLED: {"color": BLUE, "marker": "o", "ls": DASHES[0]},
    SHARED_TRUNK: {"color": ORANGE, "marker": "s", "ls": DASHES[1]},
    TWO_STAGE: {"color": GREEN, "marker": "D", "ls": DASHES[2]},
}


class Shape(NamedTuple):
    """A network: its architecture, and how deep and wide each of its trunks is.

    The first stage of two has a layer less than the second.
    """

    architecture: str
    depth: int
    width: int


PAPER_SHAPE = Shape(TWO_STAGE, 3, 128)
"""The two-stage network that learns from the paper's amount of data."""

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
        others = (SHARED_TRUNK, TWO_STAGE)
        return (
            *(Shape(DECOUPLED, depth, width) for depth in self.depths for width in self.widths),
            *(Shape(name, self.compared_depth, width) for name in others for width in self.widths),
        )


@dataclass(frozen=True, eq=False)
class TrialResults:
    """All trials of a plan, and networks that learnt from the paper's amount of data, by pose."""

    plan: Plan
    done: Sequence[Trial]
    with_little_data: Mapping[Pose, Trial]

    @cached_property
    def trials(self) -> pd.DataFrame:
        """A row for every trial; the index is its shape."""
        return pd.DataFrame(self.done).set_index(list(Shape._fields))

    @cached_property
    def means(self) -> pd.DataFrame:
        """Errors and parameters, mean over the seeds, by shape."""
        by_shape = self.trials.drop(columns="seed").groupby(level=list(Shape._fields), sort=False)
        return by_shape.mean()

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


def networks(size: Numbers, progress: Progress) -> tuple[Numbers, Figures]:
    """Train every shape on the same samples of the straight arm, and test."""
    results = explore(Plan(**size), progress)
    return numbers_of(results), figures_of(results)


def explore(plan: Plan, progress: Progress) -> TrialResults:
    """Carry out a plan on the arm of the paper."""
    arm = open_arm("cdsm")
    training, test = _datasets(arm, SingleContact(samples=plan.samples), plan.test_samples)
    cases = [(shape, seed) for shape in plan.shapes for seed in plan.seeds]
    settings = FitSettings(epochs=plan.epochs, batch_size=plan.batch_size)
    done: list[Trial] = []
    with WorkerPool(min(plan.workers, os.cpu_count() or 1), training, test, settings) as pool:
        for result in pool.map(trial, *zip(*cases, strict=True)):
            done.append(result)
            progress(0.85 * len(done) / len(cases))
    with_little_data = {}
    for pose in plan.paper_poses:
        protocol = SingleContact(
            samples=PAPER_SAMPLES, pose=pose, noise=False, no_contact_fraction=0.0
        )
        like_paper = FitSettings(epochs=2 * plan.epochs, batch_size=PAPER_BATCH_SIZE)
        few = _datasets(arm, protocol, plan.test_samples)
        with_little_data[pose] = trial(*few, like_paper, PAPER_SHAPE, 0)
    return TrialResults(plan, done, with_little_data)


def _datasets(arm: Arm, protocol: SingleContact, test_samples: int) -> tuple[Dataset, Dataset]:
    """To train on, and to test on."""
    test = replace(protocol, samples=test_samples)
    return draw_dataset(arm, protocol, seed=0), draw_dataset(arm, test, seed=20_260_002)


def trial(
    training: Dataset, test: Dataset, settings: FitSettings, shape: Shape, seed: int
) -> Trial:
    """Train and test; on one thread, so that the same seed gives the same metrics.

    The seed is that of the initial weights, the split and the order of the batches. Parameters are
    those behind the answers; those that state the uncertainty do not count.
    """
    network = _built(shape, training.arm, seed)
    fit(network, training, replace(settings, seed=seed, threads=1))
    answer = contact_answer(network.double(), test.tension_difference_n, test.command_rad)
    metrics = evaluate_answer(answer, test).metrics
    parameters = (p for n, p in network.named_parameters() if not n.startswith("spread."))
    return {
        **shape._asdict(),
        "seed": seed,
        PARAMETERS: sum(part.numel() for part in parameters),
        WRONG: 100.0 * (1.0 - metrics.contact_accuracy),
        DIRECTION: metrics.errors.direction_mae_deg,
        FORCE: metrics.errors.magnitude_mae_n,
        FORCE_RMSE: metrics.errors.magnitude_rmse_n,
    }


def _built(shape: Shape, arm: Arm, seed: int) -> ContactNetwork:
    """A network of that shape, with the initial weights that the seed gives."""
    inputs = (arm.cable_count, arm.segment_count)
    widths = [shape.width] * shape.depth
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        if shape.architecture == TWO_STAGE:
            return TwoStageNetwork(*inputs, widths[:-1] or widths, widths)
        decoupled = shape.architecture == DECOUPLED
        return (DecoupledNetwork if decoupled else SharedBackboneNetwork)(*inputs, widths)


def numbers_of(results: TrialResults) -> Numbers:
    """All that the text of the study names, from trials of any plan's size."""
    plan = results.plan
    means = results.means
    together = results.ratios(SHARED_TRUNK, DECOUPLED)
    pays = max(together[metric] for metric in PAPER_ERRORS) < 1.0 / together[PARAMETERS]
    stages = results.ratios(TWO_STAGE, SHARED_TRUNK)
    least = results.smallest_like_the_paper()
    reached = "No decoupled network tried here is as good as the paper’s in all."
    if least is not None:
        reached = (
            "The smallest decoupled networks tried that are as good as the paper’s have "
            f"{_layers(least.depth)} of {least.width} each, "
            f"{means.loc[least, PARAMETERS]:,.0f} parameters in all."
        )
    widest = max(plan.widths)
    return {
        "plan": plan,
        "seeds": ", ".join(str(seed) for seed in plan.seeds),
        "narrowest": min(plan.widths),
        "widest": widest,
        "paper_samples": PAPER_SAMPLES,
        "reached": reached,
        "at_the_widest": "; ".join(
            f"{s.architecture} {means.loc[s, DIRECTION]:.2f}°, {means.loc[s, FORCE]:.2f} N"
            for s in plan.shapes
            if s.depth == plan.compared_depth and s.width == widest
        ),
        "apart": _ratios({metric: 1.0 / together[metric] for metric in PAPER_ERRORS}),
        "apart_agrees": [together[metric] >= 1.0 for metric in PAPER_ERRORS],
        "together": _ratios(together),
        "fewer": together[PARAMETERS],
        "pays": pays,
        "pays_why": "The errors grow by less than the parameters shrink."
        if pays
        else "Some error grows by more than the parameters shrink.",
        "stages": _ratios(stages),
        "stages_agree": [stages[metric] < 1.0 for metric in (DIRECTION, FORCE)],
        "little_data": list(_little_data(results)),
        "shapes": [
            (*s, f"{means.loc[s, PARAMETERS]:,.0f}", *means.loc[s, list(PAPER_ERRORS)])
            for s in plan.shapes
        ],
        "little_data_rows": [
            *(
                (_POSES[pose], 100.0 - one[WRONG], one[DIRECTION], one[FORCE], one[FORCE_RMSE])
                for pose, one in results.with_little_data.items()
            ),
            ("the paper", "over 98", 5.96, 9.97, 14.26),
        ],
    }


def _layers(depth: int) -> str:
    return f"{depth} layer{'s' if depth > 1 else ''}"


def _ratios(ratios: Mapping[str, float]) -> str:
    wrong, direction, force = (ratios[metric] for metric in PAPER_ERRORS)
    return f"×{wrong:.2f} wrong contacts, ×{direction:.2f} direction, ×{force:.2f} force"


def _little_data(results: TrialResults) -> Iterator[dict[str, Any]]:
    for pose, one in results.with_little_data.items():
        for what, metric, unit in (("direction", DIRECTION, "°"), ("force", FORCE, "N")):
            ours = one[metric]
            theirs = PAPER_ERRORS[metric]
            why = (
                "Less than the paper’s, so the amount of data alone does not make that error."
                if ours <= theirs
                else "More than the paper’s: the error of so little training data."
            )
            yield {
                "pose": _POSES[pose],
                "what": what,
                "ours": ours,
                "theirs": theirs,
                "unit": unit,
                "little_why": why,
            }


def figures_of(results: TrialResults) -> Figures:
    """Errors by width, a line for each depth; and of the three architectures by parameters."""
    plan = results.plan
    depths, metric_axes = _metric_panels()
    for axes, metric in zip(metric_axes, PAPER_ERRORS, strict=True):
        for n, depth in enumerate(plan.depths):
            shapes = [Shape(DECOUPLED, depth, width) for width in plan.widths]
            style = {"color": SERIES[n], "marker": "osD^v"[n], "ls": DASHES[n]}
            label = _layers(depth) if axes is metric_axes[0] else ""
            _curve(axes, plan.widths, shapes, results, metric, **style, label=label)
        axes.set(xscale="log", xlabel="width of every layer", xticks=plan.widths)
        axes.set_xticks((), minor=True)
        plain_ticks(axes.xaxis)
    metric_axes[0].plot([], [], color=BLACK, ls="--", lw=1.0, label="the paper’s network")
    depths.legend(loc="outside upper center", ncols=1 + len(plan.depths))
    architectures, metric_axes = _metric_panels()
    for axes, metric in zip(metric_axes, PAPER_ERRORS, strict=True):
        for name, style in _STYLES.items():
            shapes = [Shape(name, plan.compared_depth, width) for width in plan.widths]
            parameters = [results.means.loc[shape, PARAMETERS] for shape in shapes]
            label = name if axes is metric_axes[0] else ""
            _curve(axes, parameters, shapes, results, metric, **style, label=label)
        axes.set(xscale="log", xlabel="thousand parameters (logarithmic)")
        plain_log_ticks(axes.xaxis)
        plain_ticks(axes.xaxis, 1e-3)
    architectures.legend(loc="outside upper center", ncols=3)
    return {"networks_depth_and_width": depths, "networks_architectures": architectures}


def _metric_panels() -> tuple[Any, Any]:
    """A figure of one panel for each metric, with the paper's error in it."""
    figure, grid_axes = panels(1, len(PAPER_ERRORS), 3.5)
    for axes, (metric, paper) in zip(grid_axes[0], PAPER_ERRORS.items(), strict=True):
        axes.axhline(paper, color=BLACK, ls="--", lw=1.0)
        axes.set(yscale="log", ylabel=f"{metric} (logarithmic)".replace("wrong,", "wrong class,"))
        plain_log_ticks(axes.yaxis)
    return figure, grid_axes[0]


def _curve(
    axes: Any,
    x: Sequence[float],
    shapes: Sequence[Shape],
    results: TrialResults,
    metric: str,
    **style: Any,
) -> None:
    """Means over the seeds as a line, each seed as a faint dot."""
    axes.plot(x, [results.means.loc[shape, metric] for shape in shapes], lw=1.6, ms=6, **style)
    for abscissa, shape in zip(x, shapes, strict=True):
        for error in results.trials.loc[[shape], metric]:
            axes.plot(abscissa, error, ".", color=style["color"], ms=4, alpha=0.45)
