"""Section III-C: how deep and wide, together or apart, and what an answer costs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from cablesense_gap.report.style import plain_log_ticks
from examples.paper.drawing import (
    BLACK,
    BLUE,
    DASHES,
    GREEN,
    ORANGE,
    SERIES,
    one_panel,
    panels,
    plain_ticks,
)
from examples.paper.network_trials import (
    DECOUPLED,
    DIRECTION,
    FORCE,
    FORCE_RMSE,
    PAPER_ERRORS,
    PAPER_SAMPLES,
    PARAMETERS,
    SHARED_TRUNK,
    TWO_STAGE,
    WRONG,
    Plan,
    Shape,
    TrialResults,
    explore,
)
from examples.paper.study import Figures, Numbers, Progress

_POSES = {"straight": "straight arm", "random": "poses within ±10°, unknown"}
_STYLES: dict[str, dict[str, Any]] = {
    DECOUPLED: {"color": BLUE, "marker": "o", "ls": DASHES[0]},
    SHARED_TRUNK: {"color": ORANGE, "marker": "s", "ls": DASHES[1]},
    TWO_STAGE: {"color": GREEN, "marker": "D", "ls": DASHES[2]},
}


def networks(size: Numbers, progress: Progress) -> tuple[Numbers, Figures]:
    """Train every shape on the same samples of the straight arm, test, and time its answers."""
    results = explore(Plan(**size), progress)
    return numbers_of(results), figures_of(results)


def numbers_of(results: TrialResults) -> Numbers:
    """All that the text of the study names, from trials of any plan's size."""
    plan, means = results.plan, results.means
    together = results.ratios(SHARED_TRUNK, DECOUPLED)
    fewer = together[PARAMETERS]
    pays = max(together[metric] for metric in PAPER_ERRORS) < 1.0 / fewer
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
            f"{shape.architecture} {means.loc[shape, DIRECTION]:.2f}°, "
            f"{means.loc[shape, FORCE]:.2f} N, {cost_us:.0f} µs"
            for shape, cost_us in results.cost_us.items()
            if shape.width == widest
        ),
        "apart": _ratios({metric: 1.0 / together[metric] for metric in PAPER_ERRORS}),
        "apart_agrees": [together[metric] >= 1.0 for metric in PAPER_ERRORS],
        "together": _ratios(together),
        "fewer": fewer,
        "cheaper": results.cost_ratio(SHARED_TRUNK, DECOUPLED),
        "pays": pays,
        "pays_why": "The errors grow by less than the parameters shrink."
        if pays
        else "Some error grows by more than the parameters shrink.",
        "stages": _ratios(stages),
        "stages_agree": [stages[metric] < 1.0 for metric in (DIRECTION, FORCE)],
        "little_data": list(_little_data(results)),
        "shapes": [
            (
                *shape, f"{means.loc[shape, PARAMETERS]:,.0f}",
                *means.loc[shape, list(PAPER_ERRORS)], results.cost_us.get(shape, "–"),
            )
            for shape in plan.shapes
        ],
        "little_data_rows": [
            *(
                (
                    _POSES[pose], 100.0 - one[WRONG],
                    *(one[metric] for metric in (DIRECTION, FORCE, FORCE_RMSE)),
                )
                for pose, one in results.with_little_data.items()
            ),
            ("the paper", "over 98", 5.96, 9.97, 14.26),
        ],
    }  # fmt: skip


def _layers(depth: int) -> str:
    return f"{depth} layer{'s' if depth > 1 else ''}"


def _ratios(ratios: Mapping[str, float]) -> str:
    wrong, direction, force = (ratios[metric] for metric in PAPER_ERRORS)
    return f"×{wrong:.2f} wrong contacts, ×{direction:.2f} direction, ×{force:.2f} force"


def _little_data(results: TrialResults) -> Iterator[dict[str, Any]]:
    for pose, one in results.with_little_data.items():
        for what, metric, unit in (("direction", DIRECTION, "°"), ("force", FORCE, "N")):
            ours, theirs = one[metric], PAPER_ERRORS[metric]
            why = (
                "Less than the paper’s, so the amount of data alone does not make that error."
                if ours <= theirs
                else "More than the paper’s: with so little training data this is what is left."
            )
            yield {
                "pose": _POSES[pose], "what": what, "ours": ours, "theirs": theirs, "unit": unit,
                "little_why": why,
            }  # fmt: skip


def figures_of(results: TrialResults) -> Figures:
    """All pictures of the study; to be called in the report's style."""
    return {
        "networks_depth_and_width": depth_figure(results),
        "networks_architectures": architecture_figure(results),
        "networks_cost": cost_figure(results),
    }


def depth_figure(results: TrialResults) -> Any:
    """Errors of the decoupled networks against width, a line for each depth."""
    plan = results.plan
    figure, every = _metric_panels()
    for axes, metric in zip(every, PAPER_ERRORS, strict=True):
        for n, depth in enumerate(plan.depths):
            shapes = [Shape(DECOUPLED, depth, width) for width in plan.widths]
            _curve(
                axes, plan.widths, shapes, results, metric,
                color=SERIES[n % len(SERIES)], marker="osD^v"[n % 5], ls=DASHES[n % len(DASHES)],
                label=_layers(depth) if axes is every[0] else "",
            )  # fmt: skip
        axes.set(xscale="log", xlabel="width of every layer", xticks=plan.widths)
        axes.set_xticks((), minor=True)
        plain_ticks(axes.xaxis)
    every[0].plot([], [], color=BLACK, ls="--", lw=1.0, label="the paper’s network")
    figure.legend(loc="outside upper center", ncols=1 + len(plan.depths))
    return figure


def architecture_figure(results: TrialResults) -> Any:
    """Errors of the three architectures against their number of parameters."""
    figure, every = _metric_panels()
    for axes, metric in zip(every, PAPER_ERRORS, strict=True):
        for name, style in _STYLES.items():
            shapes = [shape for shape in results.plan.compared if shape.architecture == name]
            parameters = [results.means.loc[shape, PARAMETERS] for shape in shapes]
            label = name if axes is every[0] else ""
            _curve(axes, parameters, shapes, results, metric, **style, label=label)
        axes.set(xscale="log", xlabel="thousand parameters (logarithmic)")
        plain_log_ticks(axes.xaxis)
        plain_ticks(axes.xaxis, 1e-3)
    figure.legend(loc="outside upper center", ncols=3)
    return figure


def cost_figure(results: TrialResults) -> Any:
    """Force error of the three architectures against the time of one answer."""
    figure, axes = one_panel(3.6, width=0.72)
    for name, style in _STYLES.items():
        costs = {shape: us for shape, us in results.cost_us.items() if shape.architecture == name}
        errors_n = [results.means.loc[shape, FORCE] for shape in costs]
        axes.plot(list(costs.values()), errors_n, **style, lw=1.4, ms=7, label=name)
        for (shape, at_us), error_n in zip(costs.items(), errors_n, strict=True):
            axes.annotate(
                str(shape.width), (at_us, error_n), xytext=(5, 5), textcoords="offset points",
                fontsize=8, color=style["color"],
            )  # fmt: skip
    axes.set(
        xlabel="one answer in ONNX Runtime, µs", ylabel="force MAE, N (logarithmic)", yscale="log"
    )
    plain_log_ticks(axes.yaxis)
    axes.set_xlim(0.0, None)
    figure.legend(loc="outside right center")
    return figure


def _metric_panels() -> tuple[Any, Any]:
    """A figure of one panel for each metric, with the paper's error in it."""
    figure, every = panels(1, len(PAPER_ERRORS), 3.5)
    for axes, (metric, paper) in zip(every[0], PAPER_ERRORS.items(), strict=True):
        axes.axhline(paper, color=BLACK, ls="--", lw=1.0)
        axes.set(yscale="log", ylabel=f"{metric} (logarithmic)".replace("wrong,", "wrong class,"))
        plain_log_ticks(axes.yaxis)
    return figure, every[0]


def _curve(
    axes: Any, x: Sequence[float], shapes: Sequence[Shape], results: TrialResults, metric: str,
    **style: Any,
) -> None:  # fmt: skip
    """Means over the seeds as a line, each seed as a faint dot."""
    axes.plot(x, [results.means.loc[shape, metric] for shape in shapes], lw=1.6, ms=6, **style)
    for at, shape in zip(x, shapes, strict=True):
        for error in results.trials.loc[[shape], metric]:
            axes.plot(at, error, ".", color=style["color"], ms=4, alpha=0.45)
