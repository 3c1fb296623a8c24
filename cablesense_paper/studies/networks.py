"""Section III-C: how deep and wide, together or apart, and what an answer costs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from cablesense_gap.report.style import plain_log_ticks
from cablesense_paper.drawing import (
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
from cablesense_paper.network_trials import (
    DECOUPLED,
    DIRECTION,
    FORCE,
    METRICS,
    PAPER_ERRORS,
    PAPER_SAMPLES,
    SHARED_TRUNK,
    TWO_STAGE,
    Plan,
    Shape,
    TrialResults,
    explore,
)
from cablesense_paper.study import Progress
from cablesense_paper.study_result import Agreement, StudyResult, study_result, study_size

_POSES = {"straight": "straight arm", "random": "poses within ±10°, unknown"}
_STYLES = {
    DECOUPLED: (BLUE, "o", DASHES[0]),
    SHARED_TRUNK: (ORANGE, "s", DASHES[1]),
    TWO_STAGE: (GREEN, "D", DASHES[2]),
}


def run(quick: bool, progress: Progress) -> StudyResult:
    """Train every shape on the same samples of the straight arm, test, and time its answers."""
    return result_of(explore(Plan(**study_size("networks", quick)), progress))


def result_of(results: TrialResults) -> StudyResult:
    """The study, from trials of any plan's size; to be called in the report's style."""
    plan = results.plan
    together = results.error_ratios(SHARED_TRUNK, DECOUPLED)
    fewer = results.parameter_ratio(SHARED_TRUNK, DECOUPLED)
    pays = max(together.values()) < 1.0 / fewer
    stages = results.error_ratios(TWO_STAGE, SHARED_TRUNK)
    numbers = {
        "plan": plan,
        "seeds": ", ".join(str(seed) for seed in plan.seeds),
        "narrowest": min(plan.widths),
        "widest": max(plan.widths),
        "paper_samples": PAPER_SAMPLES,
        "reached": _reached(results),
        "at_the_widest": "; ".join(
            f"{shape.architecture} {results.mean(shape, DIRECTION):.2f}°, "
            f"{results.mean(shape, FORCE):.2f} N, {cost_us:.0f} µs"
            for shape, cost_us in results.cost_us.items()
            if shape.width == max(plan.widths)
        ),
        "apart": _ratios({name: 1.0 / ratio for name, ratio in together.items()}),
        "apart_agrees": Agreement.of_parts([ratio >= 1.0 for ratio in together.values()]),
        "together": _ratios(together),
        "fewer": fewer,
        "cheaper": results.cost_ratio(SHARED_TRUNK, DECOUPLED),
        "pays_agrees": Agreement.YES if pays else Agreement.PARTLY,
        "pays_why": "The errors grow by less than the parameters shrink."
        if pays
        else "Some error grows by more than the parameters shrink.",
        "stages": _ratios(stages),
        "stages_agree": Agreement.of_parts([stages[m] < 1.0 for m in (DIRECTION, FORCE)]),
        "little_data": list(_little_data(results)),
        "shapes": [
            (
                *shape, f"{results.parameters(shape):,}",
                *(results.mean(shape, metric) for metric in METRICS),
                results.cost_us.get(shape, "–"),
            )
            for shape in plan.shapes
        ],
        "little_data_rows": [
            *(
                (
                    _POSES[pose], 100.0 * (1.0 - one.wrong_contact), one.direction_mae_deg,
                    one.magnitude_mae_n, one.magnitude_rmse_n,
                )
                for pose, one in results.with_little_data.items()
            ),
            ("the paper", "over 98", 5.96, 9.97, 14.26),
        ],
    }  # fmt: skip
    figures = {
        "networks_depth_and_width": depth_figure(results),
        "networks_architectures": architecture_figure(results),
        "networks_cost": cost_figure(results),
    }
    return study_result("networks", numbers, figures)


def _reached(results: TrialResults) -> str:
    least = results.smallest_like_the_paper()
    if least is None:
        return "No decoupled network tried here is as good as the paper’s in all."
    return (
        "The smallest decoupled networks tried that are as good as the paper’s have "
        f"{_layers(least.depth)} of {least.width} each, {results.parameters(least):,} parameters "
        "in all."
    )


def _layers(depth: int) -> str:
    return f"{depth} layer{'s' if depth > 1 else ''}"


def _ratios(ratios: dict[str, float]) -> str:
    wrong, direction, force = ratios.values()
    return f"×{wrong:.2f} wrong contacts, ×{direction:.2f} direction, ×{force:.2f} force"


def _little_data(results: TrialResults) -> Iterator[dict[str, Any]]:
    for pose, one in results.with_little_data.items():
        for what, metric, unit in (("direction", DIRECTION, "°"), ("force", FORCE, "N")):
            ours, theirs = METRICS[metric](one), PAPER_ERRORS[metric]
            why = (
                "Less than the paper’s, so the amount of data alone does not make that error."
                if ours <= theirs
                else "More than the paper’s: with so little training data this is what is left."
            )
            yield {
                "pose": _POSES[pose], "what": what, "ours": ours, "theirs": theirs, "unit": unit,
                "little_why": why,
            }  # fmt: skip


def depth_figure(results: TrialResults) -> Any:
    """Errors of the decoupled networks against width, a line for each depth."""
    plan = results.plan
    figure, every = _metric_panels()
    for axes, metric in zip(every, METRICS, strict=True):
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
    for axes, metric in zip(every, METRICS, strict=True):
        for architecture, (colour, mark, dashes) in _STYLES.items():
            shapes = [s for s in results.plan.compared if s.architecture == architecture]
            _curve(
                axes, [results.parameters(shape) for shape in shapes], shapes, results, metric,
                color=colour, marker=mark, ls=dashes,
                label=architecture if axes is every[0] else "",
            )  # fmt: skip
        axes.set(xscale="log", xlabel="thousand parameters (logarithmic)")
        plain_log_ticks(axes.xaxis)
        plain_ticks(axes.xaxis, 1e-3)
    figure.legend(loc="outside upper center", ncols=3)
    return figure


def cost_figure(results: TrialResults) -> Any:
    """Force error of the three architectures against the time of one answer."""
    figure, axes = one_panel(3.6, width=0.72)
    for architecture, (colour, mark, dashes) in _STYLES.items():
        shapes = [shape for shape in results.cost_us if shape.architecture == architecture]
        x = [results.cost_us[shape] for shape in shapes]
        y = [results.mean(shape, FORCE) for shape in shapes]
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
    figure.legend(loc="outside right center")
    return figure


def _metric_panels() -> tuple[Any, Any]:
    """A figure of one panel for each metric, with the paper's error in it."""
    figure, every = panels(1, len(METRICS), 3.5)
    for axes, metric in zip(every[0], METRICS, strict=True):
        axes.axhline(PAPER_ERRORS[metric], color=BLACK, ls="--", lw=1.0)
        axes.set(yscale="log", ylabel=f"{metric} (logarithmic)".replace("wrong,", "wrong class,"))
        plain_log_ticks(axes.yaxis)
    return figure, every[0]


def _curve(
    axes: Any, x: Sequence[float], shapes: Sequence[Shape], results: TrialResults, metric: str,
    **style: Any,
) -> None:  # fmt: skip
    """Means over the seeds as a line, each seed as a faint dot."""
    axes.plot(x, [results.mean(shape, metric) for shape in shapes], lw=1.6, ms=6, **style)
    for at, shape in zip(x, shapes, strict=True):
        for error in results.errors(shape, metric):
            axes.plot(at, error, ".", color=style["color"], ms=4, alpha=0.45)
