"""Figures of the studies: colours, line styles, panels, grids of panels. Imports matplotlib.

Colours are Okabe and Ito's; series differ in dashes or marks too, for grey print.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import LogLocator, NullFormatter
from numpy.typing import ArrayLike

from cablesense_base import Array
from cablesense_gap.report.style import WIDTH_IN

BLUE = "#0072B2"
ORANGE = "#E69F00"
GREEN = "#009E73"
VERMILION = "#D55E00"
PURPLE = "#CC79A7"
SKY = "#56B4E9"
BLACK = "#1C2126"
GREY = "#9AA3AD"
SERIES = (BLUE, ORANGE, GREEN, VERMILION, PURPLE, SKY)
DASHES = ("-", "--", "-.", ":")
DOTTED: Any = (0, (1, 1))
"""The dashes of a bound's line."""


def panels(
    rows: int,
    columns: int,
    height_in: float,
    *,
    width: float = 1.0,
    grid: str = "both",
    **options: Any,
) -> tuple[Any, Any]:
    """A figure and its axes (rows, columns); `width` is the share of the page's."""
    figure, grid_axes = plt.subplots(
        rows,
        columns,
        figsize=(width * WIDTH_IN, height_in),
        layout="constrained",
        squeeze=False,
        **options,
    )
    if grid:
        for axes in grid_axes.ravel():
            axes.grid(axis=grid)
    return figure, grid_axes


def one_panel(height_in: float, *, width: float = 1.0, grid: str = "both") -> tuple[Any, Any]:
    """A figure and its only axes."""
    figure, grid_axes = panels(1, 1, height_in, width=width, grid=grid)
    return figure, grid_axes[0, 0]


def plot_by_cable(axes: Any, time_s: Array, values: Array, **style: Any) -> None:
    """One line a cable for values (T, M): colour by segment, dashes within, for sets of three."""
    for i, line in enumerate(values.T):
        axes.plot(
            time_s, line, color=SERIES[i // 3], ls=DASHES[i % 3], label=f"cable {i + 1}", **style
        )
    axes.set(xlabel="time, s", xlim=(0.0, time_s[-1]))


def plain_ticks(axis: Any, scale: float = 1.0) -> None:
    """Tick labels as plain numbers, without powers of ten."""
    axis.set_major_formatter(lambda value, _: f"{value * scale:g}")


def plain_log_ticks(axis: Any) -> None:
    """Ticks of a logarithmic axis as 0.1, 0.2, 0.5, 1 … rather than powers."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    plain_ticks(axis)
    axis.set_minor_formatter(NullFormatter())


def confusion_grid(
    rows: Mapping[str, Sequence[ArrayLike]],
    columns: Sequence[str],
    names: Sequence[str],
    row_in: float,
) -> Any:
    """A figure of confusion matrices, the rows by name.

    Counts of true classes stand down, of answered ones across, in percent of each row. A cell that
    never occurred stays empty; one that did has its share to two digits.
    """
    figure, grid_axes = panels(len(rows), len(columns), row_in * len(rows) + 0.3, grid="")
    for line, (label, matrices) in zip(grid_axes, rows.items(), strict=True):
        for axes, counts in zip(line, matrices, strict=True):
            table = np.asarray(counts, dtype=float)
            share = 100.0 * table / np.maximum(table.sum(axis=1, keepdims=True), 1.0)
            axes.imshow(share, cmap="Blues", vmin=0.0, vmax=120.0)
            for row, column in np.argwhere(table > 0):
                value = share[row, column]
                axes.text(
                    column,
                    row,
                    shown_share(value),
                    ha="center",
                    va="center",
                    fontsize=7.6,
                    color="white" if value > 60.0 else BLACK,
                )
            axes.set_xticks(range(len(names)), names)
            axes.set_yticks(range(len(names)), names)
            axes.tick_params(length=0)
            axes.spines[:].set_visible(False)
        line[0].set_ylabel(f"{label}\ntrue")
    for top, bottom, column in zip(grid_axes[0], grid_axes[-1], columns, strict=True):
        top.set_title(column)
        bottom.set_xlabel("answered")
    return figure


def shown_share(percent: float) -> str:
    """`99.9`, `0.05`: never 100 unless it is just that."""
    if percent == 100.0:
        return "100"
    if percent >= 10.0:
        return f"{min(percent, 99.9):.1f}"
    return f"{percent:.1f}" if percent >= 1.0 else f"{percent:.2f}"
