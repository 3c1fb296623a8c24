"""The gap by cable, by cable set and by regime: before, after, and the floor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from cablesense_gap.report.figure_style import (
    AFTER,
    BEFORE,
    FLOOR,
    GRID,
    LEAST_N,
    OTHER,
    WIDTH_IN,
    as_uri,
    plain_log_ticks,
)
from cablesense_gap.residuals.decomposition import CABLE, LOOP, SET, Decomposition
from cablesense_gap.residuals.row_groups import REGIMES


def cable_figure(before: Decomposition, after: Decomposition, after_label: str) -> str:
    """RMS gap of each cable as bars; only those before where `after_label` is empty."""
    import matplotlib.pyplot as plt

    names = [part.member for part in before.of_group(CABLE)]
    x = np.arange(len(names))
    figure, axes = plt.subplots(figsize=(WIDTH_IN, 2.7), layout="constrained")
    shown = [(before, 0.0, BEFORE, "nominal arm")]
    if after_label:
        shown = [(before, -0.2, BEFORE, "nominal arm"), (after, 0.2, AFTER, after_label)]
    for found, aside, colour, label in shown:
        size = {part.member: part.rms_n for part in found.of_group(CABLE)}
        heights = [size.get(name, np.nan) for name in names]
        axes.bar(x + aside, heights, 0.38, color=colour, label=label)
    axes.axhline(before.floor_n, color=FLOOR, ls="--", lw=1.2, label="floor")
    axes.set_xticks(x, [name.rpartition("_")[2] for name in names])
    axes.set(xlabel="cable", ylabel="RMS gap, N", xlim=(-0.6, len(names) - 0.4))
    axes.grid(axis="y")
    figure.legend(loc="outside upper right", ncols=3)
    return as_uri(figure)


def regime_figure(before: Decomposition, after: Decomposition, after_label: str) -> str:
    """RMS gap by regime, each as a line from before to after."""
    return _dumbbells(before, after, after_label, (*REGIMES, LOOP))


def set_figure(before: Decomposition, after: Decomposition, after_label: str) -> str:
    """RMS gap of each cable set's common mode and bending parts, likewise."""
    return _dumbbells(before, after, after_label, (SET,))


def _dumbbells(
    before: Decomposition, after: Decomposition, after_label: str, groups: Sequence[str]
) -> str:
    import matplotlib.pyplot as plt

    remaining = {(part.group, part.member): part.rms_n for part in after.parts}
    labels: list[str] = []
    heads: list[tuple[float, str]] = []
    lines: list[tuple[float, float, float]] = []
    y = 0.0
    for group in groups:
        parts = before.of_group(group)
        if not parts:
            continue
        if len(groups) > 1:
            heads.append((y, group))
            y += 1.0
        for part in parts:
            lines.append((y, part.rms_n, remaining.get((group, part.member), np.nan)))
            labels.append(part.member.replace("_", " "))
            y += 1.0
        y += 0.35
    figure, axes = plt.subplots(figsize=(WIDTH_IN, 0.8 + 0.205 * y), layout="constrained")
    at, start, end = (np.array(column) for column in zip(*lines, strict=True))
    start, end = np.maximum(start, LEAST_N), np.maximum(end, LEAST_N)
    _draw(axes, at, start, end, after_label)
    axes.axvline(before.floor_n, color=FLOOR, ls="--", lw=1.2, label="floor")
    sizes = np.concatenate([start, end])
    axes.set_xlim(
        max(min(np.nanmin(sizes) / 1.2, before.floor_n / 2.0), LEAST_N),
        max(np.nanmax(sizes) * 1.2, before.floor_n * 5.0, 10.0 * LEAST_N),
    )
    axes.set_yticks(at, labels)
    for height, words in heads:
        axes.text(
            -0.012, height, words, weight="bold", ha="right", va="center",
            transform=axes.get_yaxis_transform(),
        )  # fmt: skip
    axes.set_ylim(y - 0.4, -0.8)
    figure.legend(loc="outside upper right", ncols=3)
    return as_uri(figure)


def _draw(axes: Any, at: Any, start: Any, end: Any, after_label: str) -> None:
    axes.scatter(start, at, s=34, color=BEFORE, zorder=3, label="nominal arm", marker="D")
    if after_label:
        axes.hlines(at, np.fmin(start, end), np.fmax(start, end), color=OTHER, lw=2.2, zorder=2)
        axes.scatter(end, at, s=34, color=AFTER, zorder=4, label=after_label)
    axes.hlines(at, 0, 1, color=GRID, lw=0.7, zorder=0, transform=axes.get_yaxis_transform())
    axes.set_xscale("log")
    plain_log_ticks(axes.xaxis)
    axes.set_xlabel("RMS gap, N (logarithmic)")
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x")
