"""The pictures of the gap of Table II, drawn in the style of the reports."""

from __future__ import annotations

from typing import Any

import numpy as np

from cablesense_gap.report.figure_style import AFTER, BEFORE, GRID, INK, OTHER, WIDTH_IN
from cablesense_gap.table2.findings import Findings
from cablesense_gap.table2.words import loads

SETS = ("cables 1 to 3", "cables 4 to 6", "cables 7 to 9")
COLOURS = (BEFORE, AFTER, "#009E73")


def gap_figure(found: Findings) -> Any:
    """Measured less simulated change of every cable, one panel a load, with its internal part."""
    import matplotlib.pyplot as plt

    figure, every = plt.subplots(
        2, 3, figsize=(WIDTH_IN, 4.4), sharex=True, sharey=True, layout="constrained"
    )
    cables = np.arange(1, 10)
    colours = np.repeat(COLOURS, 3)
    for axes, name, gap, inner in zip(
        every.ravel(), loads(found), found.gap_n, found.internal_n, strict=True
    ):
        axes.bar(cables, gap, 0.72, color=colours)
        for k in range(3):
            axes.hlines(inner[3 * k], 3 * k + 0.5, 3 * k + 3.5, color=INK, lw=2.2)
        axes.axhline(0.0, color=INK, lw=0.7)
        axes.set_title(name)
        axes.set_xticks(cables)
        axes.grid(axis="y")
    figure.supxlabel("cable", fontsize=9.5)
    figure.supylabel("measured less simulated, N", fontsize=9.5)
    return figure


def proportion_figure(found: Findings) -> Any:
    """Gap under 2 kg against gap under 1 kg, beside the line of proportion."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(WIDTH_IN, 4.2), layout="constrained")
    one, two = found.gap_n[:3], found.gap_n[3:]
    along = np.array([one.min() - 0.2, one.max() + 0.2])
    band = 1.96 * np.sqrt(5.0) * found.floor_n  # of a difference between one number and two others
    axes.fill_between(along, 2.0 * along - band, 2.0 * along + band, color=GRID, lw=0)
    axes.plot(along, 2.0 * along, color=OTHER, lw=1.2)
    for k, (name, colour) in enumerate(zip(SETS, COLOURS, strict=True)):
        of_set = slice(3 * k, 3 * k + 3)
        for point, mark in enumerate("osD"):
            axes.scatter(
                one[point, of_set], two[point, of_set], s=36, color=colour, marker=mark, zorder=3,
                label=name if point == 0 else None,
            )  # fmt: skip
    for point, mark in enumerate("osD"):
        axes.scatter([], [], s=36, color=OTHER, marker=mark, label=f"load on segment {point + 1}")
    axes.set(xlabel="gap under 1 kg, N", ylabel="gap under 2 kg, N")
    axes.grid()
    figure.legend(loc="outside right center")
    return figure


def paper_figure(found: Findings) -> Any:
    """The paper's simulated changes less ours, by cable."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(WIDTH_IN, 2.6), layout="constrained")
    cables = np.arange(1, 10)
    for k, (name, apart) in enumerate(
        zip(loads(found), found.paper_n - found.nominal_n, strict=True)
    ):
        axes.plot(
            cables, apart, marker="osD"[k % 3], ms=5, lw=1.2, color=COLOURS[k % 3],
            ls="-" if k < 3 else "--", label=name,
        )  # fmt: skip
    axes.axhline(0.0, color=INK, lw=0.7)
    axes.set(xlabel="cable", ylabel="N", xticks=cables)
    axes.grid(axis="y")
    figure.legend(loc="outside right center")
    return figure
