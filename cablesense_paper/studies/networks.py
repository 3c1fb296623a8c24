"""Section III-C: how deep and wide, together or apart, and what an answer costs."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from cablesense_gap.report.figure_style import WIDTH_IN, plain_log_ticks
from cablesense_paper.palette import BLACK, BLUE, DASHES, GREEN, ORANGE, SERIES
from cablesense_paper.study import Study, Tell
from cablesense_paper.study_result import (
    Agreement,
    Comparison,
    Picture,
    SmallTable,
    StudyResult,
    picture,
)

if TYPE_CHECKING:
    from cablesense_paper.networks.shapes import Shape
    from cablesense_paper.networks.trials import Trial
    from cablesense_training.data.protocols import Pose

PAPER = {"wrong, %": 2.0, "direction MAE, °": 5.96, "force MAE, N": 9.97}
"""The paper's figures of its single-contact network, by the names used here."""

_METRICS: dict[str, Callable[[Trial], float]] = {
    "wrong, %": lambda trial: 100.0 * trial.wrong_contact,
    "direction MAE, °": lambda trial: trial.direction_mae_deg,
    "force MAE, N": lambda trial: trial.magnitude_mae_n,
}
_APART, _TRUNK, _STAGES = "decoupled", "shared trunk", "two-stage"
_STYLES = {
    _APART: (BLUE, "o", DASHES[0]),
    _TRUNK: (ORANGE, "s", DASHES[1]),
    _STAGES: (GREEN, "D", DASHES[2]),
}
_TEST_SEED = 20_260_002


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
        workers: processes that train.
    """

    depths: tuple[int, ...]
    widths: tuple[int, ...]
    compared_depth: int
    seeds: tuple[int, ...]
    samples: int
    batch_size: int
    epochs: int
    test_samples: int
    paper_poses: tuple[Pose, ...]
    workers: int


FULL = Plan(
    depths=(1, 2, 3, 4),
    widths=(16, 32, 64, 128),
    compared_depth=3,
    seeds=(0, 1),
    samples=20_480,
    batch_size=256,
    epochs=40,
    test_samples=10_240,
    paper_poses=("straight", "random"),
    workers=min(2, os.cpu_count() or 1),
)
QUICK = Plan(
    depths=(1, 2),
    widths=(32,),
    compared_depth=2,
    seeds=(0,),
    samples=4_096,
    batch_size=64,
    epochs=12,
    test_samples=2_048,
    paper_poses=("straight",),
    workers=1,
)
PAPER_SAMPLES, PAPER_BATCH_SIZE, PAPER_WIDTH = 5_000, 64, 128
_POSES: dict[Pose, str] = {"straight": "straight arm", "random": "poses within ±10°, unknown"}


def run(quick: bool, tell: Tell) -> StudyResult:
    """Train every shape on the same samples of the straight arm, test, and time its answers."""
    return explored(QUICK if quick else FULL, tell)


def explored(plan: Plan, tell: Tell) -> StudyResult:
    """The study at the size of a plan."""
    from cablesense_paper.networks.shapes import ARCHITECTURES, Shape
    from cablesense_paper.networks.trials import answer_us, trials
    from cablesense_sim.arm_files import open_arm
    from cablesense_training.data.dataset import Dataset
    from cablesense_training.data.protocols import SingleContact
    from cablesense_training.fit import FitSettings

    arm = open_arm("cdsm")
    training = Dataset.from_protocol(arm, SingleContact(samples=plan.samples), 0)
    test = Dataset.from_protocol(arm, SingleContact(samples=plan.test_samples), _TEST_SEED)
    grid = [Shape(_APART, depth, width) for depth in plan.depths for width in plan.widths]
    others = [
        Shape(architecture, plan.compared_depth, width)
        for architecture in ARCHITECTURES
        if architecture != _APART
        for width in plan.widths
    ]
    cases = [(shape, seed) for shape in (*grid, *others) for seed in plan.seeds]
    done: list[Trial] = []
    how = FitSettings(epochs=plan.epochs, batch_size=plan.batch_size)
    for one in trials(cases, training, test, how, plan.workers):
        done.append(one)
        tell(0.7 * len(done) / len(cases))
    few = _with_the_papers_samples(plan)
    tell(0.8)
    compared = [shape for shape in (*grid, *others) if shape.depth == plan.compared_depth]
    cost_us = {}
    for shape in compared:
        cost_us[shape] = answer_us(shape, arm)
        tell(0.8 + 0.19 * len(cost_us) / len(compared))
    least = _least_that_reaches(done)
    return StudyResult(
        lead=_lead(done, least, compared, cost_us),
        pictures=(
            _depth_picture([one for one in done if one.shape.architecture == _APART], plan),
            _compared_picture([one for one in done if one.shape in compared], plan),
            _cost_picture(done, cost_us, plan),
        ),
        tables=(_table(done, cost_us), _few_table(few)),
        comparisons=_comparisons(done, compared, cost_us, few),
        notes=(
            f"Straight arm, noise on, a fifth of the samples without contact: {plan.samples:,} "
            f"samples to train on, {plan.epochs} passes at most, {plan.test_samples:,} fresh ones "
            f"to test on, seeds {', '.join(str(seed) for seed in plan.seeds)}; figures are means "
            "over the seeds, and come out the same again. Microseconds do not: they are of one "
            "answer in ONNX Runtime on one core of this machine, the stated uncertainty "
            "included.",
            "The paper names depth, parameter count and trade-off as what it explored, and prints "
            "none of the numbers. Parameters here are those behind the answers. Each trunk has "
            "the depth and width named; the first stage of two has a layer less.",
        ),
    )


def _with_the_papers_samples(plan: Plan) -> dict[str, Trial]:
    """A two-stage network on the paper's amount of data, tested as the paper tests."""
    from cablesense_paper.networks.shapes import Shape
    from cablesense_paper.networks.trials import trial
    from cablesense_sim.arm_files import open_arm
    from cablesense_training.data.dataset import Dataset
    from cablesense_training.data.protocols import SingleContact
    from cablesense_training.fit import FitSettings

    arm, found = open_arm("cdsm"), {}
    how = FitSettings(epochs=2 * plan.epochs, batch_size=PAPER_BATCH_SIZE)
    for pose in plan.paper_poses:
        sets = [
            Dataset.from_protocol(
                arm,
                SingleContact(samples=samples, pose=pose, noise=False, no_contact_fraction=0.0),
                seed,
            )
            for samples, seed in ((PAPER_SAMPLES, 0), (plan.test_samples, _TEST_SEED))
        ]
        shape = Shape(_STAGES, 3, PAPER_WIDTH)
        found[_POSES[pose]] = trial(shape, 0, sets[0], sets[1], how)
    return found


def _mean(done: Iterable[Trial], shape: Shape, metric: str) -> float:
    return float(np.mean([_METRICS[metric](one) for one in done if one.shape == shape]))


def _shapes(done: Iterable[Trial]) -> list[Shape]:
    return list(dict.fromkeys(one.shape for one in done))


def _parameters(done: Iterable[Trial], shape: Shape) -> int:
    return next(one.parameters for one in done if one.shape == shape)


def _least_that_reaches(done: Sequence[Trial]) -> Shape | None:
    """The decoupled shape of fewest parameters that is as good as the paper in all."""
    reached = [
        shape
        for shape in _shapes(done)
        if shape.architecture == _APART
        and all(_mean(done, shape, metric) <= most for metric, most in PAPER.items())
    ]
    return min(reached, key=lambda shape: _parameters(done, shape), default=None)


def _lead(
    done: Sequence[Trial],
    least: Shape | None,
    compared: Sequence[Shape],
    cost_us: dict[Shape, float],
) -> str:
    if least is None:
        reached = "No decoupled network tried here reaches all of the paper’s figures. "
    else:
        layers = f"{least.depth} layer{'s' if least.depth > 1 else ''} of {least.width}"
        reached = (
            f"The smallest decoupled networks tried that reach the paper’s figures have {layers} "
            f"each, {_parameters(done, least):,} parameters in all. "
        )
    widest = max(shape.width for shape in compared)
    figures = []
    for shape in compared:
        if shape.width == widest:
            figures.append(
                f"{shape.architecture} {_mean(done, shape, 'direction MAE, °'):.2f}°, "
                f"{_mean(done, shape, 'force MAE, N'):.2f} N, {cost_us[shape]:.0f} µs"
            )
    return f"{reached}At a width of {widest}: {'; '.join(figures)}."


def _ratio(
    done: Sequence[Trial], compared: Sequence[Shape], ours: str, theirs: str
) -> tuple[dict[str, float], float]:
    """Errors of one architecture over those of another, by metric, and parameters likewise.

    Geometric means over the widths.
    """
    pairs = [
        (a, b)
        for a in compared
        for b in compared
        if (a.architecture, b.architecture) == (ours, theirs) and a.width == b.width
    ]

    def mean(ratios: list[float]) -> float:
        return float(np.exp(np.mean(np.log(ratios))))

    errors = {
        metric: mean([_mean(done, a, metric) / _mean(done, b, metric) for a, b in pairs])
        for metric in _METRICS
    }
    return errors, mean([_parameters(done, a) / _parameters(done, b) for a, b in pairs])


def _said(ratios: dict[str, float]) -> str:
    wrong, direction, force = ratios.values()
    return f"×{wrong:.2f} wrong contacts, ×{direction:.2f} direction, ×{force:.2f} force"


def _comparisons(
    done: Sequence[Trial],
    compared: Sequence[Shape],
    cost_us: dict[Shape, float],
    few: dict[str, Trial],
) -> tuple[Comparison, ...]:
    shared, fewer = _ratio(done, compared, _TRUNK, _APART)
    guided, _ = _ratio(done, compared, _STAGES, _TRUNK)
    cheaper = float(
        np.mean([cost_us[s] for s in compared if s.architecture == _TRUNK])
        / np.mean([cost_us[s] for s in compared if s.architecture == _APART])
    )
    better = [ratio < 1.0 for ratio in shared.values()]
    helped = [ratio < 1.0 for ratio in list(guided.values())[1:]]
    return (
        Comparison(
            "decoupled against shared trunk, same widths",
            _said({name: 1.0 / ratio for name, ratio in shared.items()}),
            "task-specific networks achieve high precision", "",
            Agreement.NO if all(better) else Agreement.PARTLY if any(better) else Agreement.YES,
            "Below 1 the decoupled networks are the more precise; tasks that are apart do not "
            "weigh on each other.",
        ),
        Comparison(
            "shared trunk against decoupled, same widths",
            f"{fewer:.0%} of the parameters, {cheaper:.0%} of the time; {_said(shared)}",
            "favorable performance-efficiency trade-off", "",
            Agreement.YES if max(shared.values()) < 1.0 / fewer else Agreement.PARTLY,
            "The errors grow by less than the parameters shrink."
            if max(shared.values()) < 1.0 / fewer
            else "Some error grows by more than the parameters shrink.",
        ),
        Comparison(
            "two-stage against shared trunk, same widths", _said(guided),
            "contact information guides force and direction", "",
            Agreement.YES if all(helped) else Agreement.PARTLY if any(helped) else Agreement.NO,
            "Below 1 knowing the contact helps; the trunk can find it in the tensions by itself, "
            "so there is little to gain.",
        ),
        *_with_little_data(few),
    )  # fmt: skip


def _with_little_data(few: dict[str, Trial]) -> Iterator[Comparison]:
    for name, one in few.items():
        for what, ours, theirs, unit in (
            ("direction error", one.direction_mae_deg, 5.96, "°"),
            ("force error", one.magnitude_mae_n, 9.97, "N"),
        ):
            yield Comparison(
                f"two-stage on {PAPER_SAMPLES:,} samples without noise, {name}: {what}",
                ours, theirs, unit, Agreement.YES if ours <= theirs else Agreement.NO,
                "Less than the paper’s, so the amount of data alone does not make that error."
                if ours <= theirs
                else "More than the paper’s: with so little training data this is what is left.",
            )  # fmt: skip


def _table(done: Sequence[Trial], cost_us: dict[Shape, float]) -> SmallTable:
    rows: list[tuple[str | float, ...]] = [
        (
            shape.architecture, shape.depth, shape.width, f"{_parameters(done, shape):,}",
            *(_mean(done, shape, metric) for metric in _METRICS),
            cost_us.get(shape, "–"),
        )
        for shape in _shapes(done)
    ]  # fmt: skip
    return SmallTable(
        "All shapes that were tried.",
        ("architecture", "layers", "width", "parameters", *_METRICS, "one answer, µs"),
        tuple(rows),
    )


def _few_table(few: dict[str, Trial]) -> SmallTable:
    rows: list[tuple[str | float, ...]] = [
        (
            name, 100.0 * (1.0 - one.wrong_contact), one.direction_mae_deg, one.magnitude_mae_n,
            one.magnitude_rmse_n,
        )
        for name, one in few.items()
    ]  # fmt: skip
    rows.append(("the paper", "over 98", 5.96, 9.97, 14.26))
    return SmallTable(
        f"A two-stage network on the paper’s amount of data: {PAPER_SAMPLES:,} samples "
        "without noise, each a contact; tested on fresh ones like them.",
        ("samples", "contact, %", "direction MAE, °", "force MAE, N", "force RMSE, N"),
        tuple(rows),
    )


def _panels(metrics: Sequence[str]) -> tuple[Any, Any]:
    import matplotlib.pyplot as plt

    figure, every = plt.subplots(
        1, len(metrics), figsize=(WIDTH_IN, 3.5), layout="constrained", squeeze=False
    )
    for axes, metric in zip(every[0], metrics, strict=True):
        axes.axhline(PAPER[metric], color=BLACK, ls="--", lw=1.0)
        axes.set(yscale="log", ylabel=f"{metric} (logarithmic)".replace("wrong,", "wrong class,"))
        plain_log_ticks(axes.yaxis)
        axes.grid()
    return figure, every[0]


def _curve(
    axes: Any, x: Sequence[float], shapes: Sequence[Shape], done: Sequence[Trial], metric: str,
    **style: Any,
) -> None:  # fmt: skip
    """Means over the seeds as a line, each seed as a faint dot."""
    axes.plot(x, [_mean(done, shape, metric) for shape in shapes], lw=1.6, ms=6, **style)
    for at, shape in zip(x, shapes, strict=True):
        for one in done:
            if one.shape == shape:
                axes.plot(at, _METRICS[metric](one), ".", color=style["color"], ms=4, alpha=0.45)


def _depth_picture(done: Sequence[Trial], plan: Plan) -> Picture:
    figure, every = _panels(list(_METRICS))
    for axes, metric in zip(every, _METRICS, strict=True):
        for n, depth in enumerate(plan.depths):
            shapes = [shape for shape in _shapes(done) if shape.depth == depth]
            _curve(
                axes, [shape.width for shape in shapes], shapes, done, metric,
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


def _compared_picture(done: Sequence[Trial], plan: Plan) -> Picture:
    figure, every = _panels(list(_METRICS))
    for axes, metric in zip(every, _METRICS, strict=True):
        for architecture, (colour, mark, dashes) in _STYLES.items():
            shapes = [shape for shape in _shapes(done) if shape.architecture == architecture]
            _curve(
                axes, [_parameters(done, shape) for shape in shapes], shapes, done, metric,
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


def _cost_picture(done: Sequence[Trial], cost_us: dict[Shape, float], plan: Plan) -> Picture:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(0.72 * WIDTH_IN, 3.6), layout="constrained")
    for architecture, (colour, mark, dashes) in _STYLES.items():
        shapes = [shape for shape in cost_us if shape.architecture == architecture]
        x = [cost_us[shape] for shape in shapes]
        y = [_mean(done, shape, "force MAE, N") for shape in shapes]
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
        f"Section III-C: cost against accuracy at {plan.compared_depth} layers; the numbers are "
        "widths.",
        "Force error against the time of one answer for three architectures",
    )


STUDY = Study(
    name="networks",
    title="Which network",
    place="III-C",
    order=100,
    quick=f"decoupled networks of {len(QUICK.depths)} depths and one width rather than "
    f"{len(FULL.depths)} and {len(FULL.widths)}, one seed rather than {len(FULL.seeds)}, "
    f"{QUICK.samples:,} samples and {QUICK.epochs} passes rather than {FULL.samples:,} and "
    f"{FULL.epochs}: networks far from learnt out, whose figures only show the way",
    run=run,
)
