"""Errors of networks against depth, width, parameters and time, as pictures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from cablesense_gap.report.figure_style import WIDTH_IN, plain_log_ticks
from cablesense_paper.networks.findings import FORCE, METRICS, PAPER_FIGURES, Findings
from cablesense_paper.networks.shapes import DECOUPLED, SHARED_TRUNK, TWO_STAGE, Shape
from cablesense_paper.palette import BLACK, BLUE, DASHES, GREEN, ORANGE, SERIES
from cablesense_paper.study_result import Picture, picture

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
