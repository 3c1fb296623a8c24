"""The residual of each cable over time, before and after."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.report.figure_style import (
    AFTER,
    BEFORE,
    FLOOR,
    LOADED,
    WIDTH_IN,
    as_uri,
)
from cablesense_gap.report.inputs import ReportInputs

Array = NDArray[np.float64]

MOST_CABLES = 24
MOST_POINTS = 3000
"""More than a picture has columns of pixels; longer recordings are drawn as their envelope."""
ROW_IN = 1.45


def time_figure(inputs: ReportInputs) -> str:
    """Small multiples with one scale; of very many cables, those with the largest gap."""
    import matplotlib.pyplot as plt

    cables, columns = _shown(inputs), inputs.arm.cables.per_segment
    rows = -(-len(cables) // columns)
    figure, axes = plt.subplots(
        rows,
        columns,
        figsize=(WIDTH_IN, ROW_IN * rows + 0.75),
        sharex=True,
        sharey=True,
        squeeze=False,
        layout="constrained",
    )
    reach_n = _reach_n(inputs)
    for panel, cable in zip(axes.flat, cables, strict=False):
        _panel(panel, inputs, cable)
        panel.set_ylim(-reach_n, reach_n)
    for panel in axes.flat[len(cables) :]:
        panel.set_visible(False)
    for panel in axes[:, 0]:
        panel.set_ylabel("residual, N")
    for panel in axes[-1]:
        panel.set_xlabel("time, s")
    figure.legend(
        *axes[0, 0].get_legend_handles_labels(), loc="outside upper right", ncols=4, fontsize=9
    )
    return as_uri(figure, "png")


def _panel(panel: Any, inputs: ReportInputs, cable: int) -> None:
    from matplotlib.transforms import blended_transform_factory

    recording, floor_n = inputs.recording, inputs.verdict.gap.floor_n
    panel.fill_between(
        recording.time_s,
        0.0,
        1.0,
        where=recording.load_segment > 0,
        step="mid",
        color=LOADED,
        lw=0,
        transform=blended_transform_factory(panel.transData, panel.transAxes),
        label="a load acts",
    )
    panel.axhspan(-2.0 * floor_n, 2.0 * floor_n, color=FLOOR, alpha=0.28, lw=0, label="±2 floors")
    drawn = [(inputs.before_n, BEFORE, 1.4, "nominal arm")]
    if inputs.after_label:
        drawn.append((inputs.after_n, AFTER, 0.9, inputs.after_label))
    for residual_n, colour, width, label in drawn:
        panel.plot(
            *_drawn(recording.time_s, residual_n[:, cable]), color=colour, lw=width, label=label
        )
    panel.set_title(inputs.arm.cable_names[cable].replace("_", " "), pad=2)
    panel.set_xlim(recording.time_s[0], recording.time_s[-1])
    panel.grid(axis="y")


def _shown(inputs: ReportInputs) -> list[int]:
    count = inputs.arm.cable_count
    if count <= MOST_CABLES:
        return list(range(count))
    size = np.nanmean(inputs.before_n**2, axis=0)
    return sorted(np.argsort(size)[-MOST_CABLES:].tolist())


def _reach_n(inputs: ReportInputs) -> float:
    """What all panels show: nearly all, so that one stray row hides nothing."""
    both = np.abs(np.concatenate([inputs.before_n, inputs.after_n]))
    known = both[np.isfinite(both)]
    largest = float(np.quantile(known, 0.999)) if known.size else 1.0
    return 1.08 * max(largest, 4.0 * inputs.verdict.gap.floor_n, 1e-3)


def _drawn(time_s: Array, values_n: Array) -> tuple[Array, Array]:
    if len(time_s) <= MOST_POINTS:
        return time_s, values_n
    edges = np.linspace(0, len(time_s), MOST_POINTS // 2 + 1).astype(int)[:-1]
    low, high = np.fmin.reduceat(values_n, edges), np.fmax.reduceat(values_n, edges)
    return np.repeat(time_s[edges], 2), np.stack([low, high], axis=-1).ravel()
