"""Pictures of a report: the gap over time, by cable, by segment and by regime; the candidates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cablesense_base import Array
from cablesense_gap.pipeline import Diagnosis
from cablesense_gap.recorded_contacts import RecordedErrors
from cablesense_gap.report.style import (
    AFTER,
    BEFORE,
    FLOOR,
    GRID,
    LEAST_N,
    LOADED,
    OTHER,
    WIDTH_IN,
    as_uri,
    percent,
    plain_log_ticks,
)
from cablesense_gap.report.text import candidate_name
from cablesense_gap.residuals import CABLE, Decomposition
from cablesense_gap.verdict import Verdict

MOST = 12
"""Candidates that are drawn."""
_MOST_CABLES = 24
_MOST_POINTS = 3000
"""More than a picture has columns of pixels; longer recordings are drawn as their envelope."""
_ROW_IN = 1.45


def drawn_budget(verdict: Verdict) -> Any:
    """A waterfall from the nominal arm's gap to the floor, as a matplotlib figure.

    Each bar is what simulating one more effect takes away; beside it is the effect's own share.
    """
    import matplotlib.pyplot as plt

    gap, unit = verdict.gap, verdict.unit
    steps = [
        (candidate_name((name,)), share.left_n, f"{share.share_n:.2f} {unit} alone")
        for name, share in verdict.shares.items()
    ]
    after_n = float(np.hypot(verdict.unexplained_n or 0.0, gap.floor_n))
    steps.append(("tolerances", after_n, f"{verdict.tolerances_n or 0.0:.2f} {unit} alone"))
    steps.append(("unexplained", gap.floor_n, percent(verdict.unexplained_share or 0.0)))
    figure, axes = plt.subplots(
        figsize=(WIDTH_IN, 0.9 + 0.34 * (len(steps) + 2)), layout="constrained"
    )
    axes.barh(0, gap.before_n, 0.62, color=BEFORE)
    axes.text(gap.before_n, 0, f" {gap.before_n:.2f} {unit}", va="center")
    level = gap.before_n
    for y, (name, left_n, text) in enumerate(steps, 1):
        low, high = sorted((level, left_n))
        colour = OTHER if name in ("tolerances", "unexplained") else AFTER
        axes.barh(y, high - low, 0.62, left=low, color=colour)
        axes.vlines(level, y - 0.69, y + 0.31, color=GRID, lw=1.0, zorder=0)
        axes.text(high, y, f" {left_n - level:+.2f} {unit}  ({text})", va="center")
        level = left_n
    last = len(steps) + 1
    axes.barh(last, gap.floor_n, 0.62, color=FLOOR)
    axes.text(gap.floor_n, last, f" {gap.floor_n:.2f} {unit}", va="center")
    names = ["gap of the nominal arm", *(name for name, *_ in steps), "floor of the sensors"]
    axes.set_yticks(range(last + 1), names)
    axes.set_ylim(last + 0.6, -0.6)
    axes.set_xlim(0.0, 1.3 * max(gap.before_n, *(left_n for _, left_n, _ in steps)))
    axes.set_xlabel(f"RMS gap, {unit}")
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x")
    return figure


def cable_picture(before: Decomposition, after: Decomposition, after_label: str) -> str:
    """RMS gap of each cable as bars; only those before where `after_label` is empty."""
    import matplotlib.pyplot as plt

    names = [part.member for part in before.of_group(CABLE)]
    x = np.arange(len(names))
    figure, axes = plt.subplots(figsize=(WIDTH_IN, 2.7), layout="constrained")
    shown = [(before, 0.0, BEFORE, "nominal arm")]
    if after_label:
        shown = [(before, -0.2, BEFORE, "nominal arm"), (after, 0.2, AFTER, after_label)]
    for parts, aside, colour, label in shown:
        size = {part.member: part.rms_n for part in parts.of_group(CABLE)}
        heights = [size.get(name, np.nan) for name in names]
        axes.bar(x + aside, heights, 0.38, color=colour, label=label)
    axes.axhline(before.floor_n, color=FLOOR, ls="--", lw=1.2, label="floor")
    axes.set_xticks(x, [name.rpartition("_")[2] for name in names])
    axes.set(xlabel="cable", ylabel="RMS gap, N", xlim=(-0.6, len(names) - 0.4))
    axes.grid(axis="y")
    figure.legend(loc="outside upper right", ncols=3)
    return as_uri(figure)


def dumbbell_picture(
    before: Decomposition, after: Decomposition, after_label: str, groups: Sequence[str]
) -> str:
    """RMS gap of each member of some groups, as a line from before to after."""
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
    for height, text in heads:
        axes.text(
            -0.012, height, text, weight="bold", ha="right", va="center",
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


def drawn_candidates(verdict: Verdict) -> Any:
    """The most probable candidates, the verdict's in colour, as a matplotlib figure."""
    import matplotlib.pyplot as plt

    shown = verdict.ranked[:MOST]
    y = np.arange(len(shown))
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(WIDTH_IN, 1.05 + 0.27 * len(shown)),
        sharey=True, width_ratios=(1.25, 1.0), layout="constrained",
    )  # fmt: skip
    for at, candidate in zip(y, shown, strict=True):
        chosen = candidate.effects == verdict.effects
        colour = AFTER if chosen else OTHER
        if candidate.held_out_ci95_n is not None:
            left.hlines(at, *np.maximum(candidate.held_out_ci95_n, LEAST_N), color=colour, lw=2.4)
        left.scatter(max(candidate.held_out_rmse_n, LEAST_N), at, s=38, color=colour, zorder=3)
        right.barh(at, candidate.probability, 0.62, color=colour)
        right.text(
            candidate.probability + 0.012, at, percent(candidate.probability), va="center",
            weight="bold" if chosen else "normal",
        )  # fmt: skip
    floor_n = max(verdict.gap.floor_n, LEAST_N)
    left.axvline(floor_n, color=FLOOR, ls="--", lw=1.2)
    left.text(
        floor_n, 1.01, "floor", color=FLOOR, ha="center", va="bottom",
        transform=left.get_xaxis_transform(),
    )  # fmt: skip
    left.set_xscale("log")
    plain_log_ticks(left.xaxis)
    left.set_yticks(y, [candidate_name(candidate.effects) for candidate in shown])
    for label, candidate in zip(left.get_yticklabels(), shown, strict=True):
        label.set_fontweight("bold" if candidate.effects == verdict.effects else "normal")
    left.set_ylim(len(shown) - 0.4, -0.6)
    left.set_xlabel(f"RMS left on held-out trials, {verdict.unit} (logarithmic)")
    right.set(xlabel="probability", xlim=(0.0, 1.12), xticks=(0.0, 0.25, 0.5, 0.75, 1.0))
    for axes in (left, right):
        axes.tick_params(axis="y", length=0)
        axes.grid(axis="x")
    return figure


def time_picture(found: Diagnosis) -> str:
    """Small multiples with one scale; of very many cables, those with the largest gap."""
    import matplotlib.pyplot as plt

    columns = found.nominal.cables.per_segment
    size = np.nanmean(found.before_n**2, axis=0)
    cables = sorted(np.argsort(size)[-_MOST_CABLES:].tolist())
    rows = -(-len(cables) // columns)
    figure, axes = plt.subplots(
        rows, columns, figsize=(WIDTH_IN, _ROW_IN * rows + 0.75),
        sharex=True, sharey=True, squeeze=False, layout="constrained",
    )  # fmt: skip
    # nearly all, so that one stray row hides nothing
    both = np.abs(np.concatenate([found.before_n, found.after_n]))
    known = both[np.isfinite(both)]
    largest = float(np.quantile(known, 0.999)) if known.size else 1.0
    reach_n = 1.08 * max(largest, 4.0 * found.verdict.gap.floor_n, 1e-3)
    for panel, cable in zip(axes.flat, cables, strict=False):
        _panel(panel, found, cable)
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


def _panel(panel: Any, found: Diagnosis, cable: int) -> None:
    from matplotlib.transforms import blended_transform_factory

    recording, floor_n = found.recording, found.verdict.gap.floor_n
    panel.fill_between(
        recording.time_s, 0.0, 1.0, where=recording.load_segment > 0, step="mid",
        color=LOADED, lw=0, label="a load acts",
        transform=blended_transform_factory(panel.transData, panel.transAxes),
    )  # fmt: skip
    panel.axhspan(-2.0 * floor_n, 2.0 * floor_n, color=FLOOR, alpha=0.28, lw=0, label="±2 floors")
    drawn = [(found.before_n, BEFORE, 1.4, "nominal arm")]
    if found.after_label:
        drawn.append((found.after_n, AFTER, 0.9, found.after_label))
    for residual_n, colour, width, label in drawn:
        panel.plot(
            *_drawn(recording.time_s, residual_n[:, cable]), color=colour, lw=width, label=label
        )
    panel.set_title(found.nominal.cable_names[cable].replace("_", " "), pad=2)
    panel.set_xlim(recording.time_s[0], recording.time_s[-1])
    panel.grid(axis="y")


def _drawn(time_s: Array, values_n: Array) -> tuple[Array, Array]:
    if len(time_s) <= _MOST_POINTS:
        return time_s, values_n
    edges = np.linspace(0, len(time_s), _MOST_POINTS // 2 + 1).astype(int)[:-1]
    low, high = np.fmin.reduceat(values_n, edges), np.fmax.reduceat(values_n, edges)
    return np.repeat(time_s[edges], 2), np.stack([low, high], axis=-1).ravel()


def drawn_errors(errors: Mapping[str, RecordedErrors]) -> Any:
    """Estimated against true force of each model, side by side: a colour for each segment."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(
        1, len(errors), figsize=(4.4 * len(errors), 4.2), squeeze=False, layout="constrained"
    )
    most = 1.05 * max(
        max(each.truth.force_n.max(), each.answer.force_n.max()) for each in errors.values()
    )
    for place, (name, each) in zip(axes[0], errors.items(), strict=True):
        place.plot([0.0, most], [0.0, most], color="0.7", lw=1)
        right = each.answer.segment == each.truth.segment
        for segment in np.unique(each.truth.segment):
            rows = each.truth.segment == segment
            colour = f"C{segment}" if segment else "0.4"
            label = f"segment {segment}" if segment else "no load"
            forces = each.truth.force_n, each.answer.force_n
            place.plot(*(f[rows & right] for f in forces), ".", ms=4, c=colour, label=label)
            place.plot(*(f[rows & ~right] for f in forces), "x", ms=5, c=colour)
        accuracy, off_n = each.whole.contact_accuracy, each.whole.errors.magnitude_mae_n
        place.set(
            title=f"{name}\nright segment {accuracy:.1%}, force off by {off_n:.2f} N",
            xlabel="true force, N (crosses: another segment, or none)",
            ylabel="estimated force, N",
        )
        place.legend()
    return figure
