"""The candidates: what each leaves on held-out trials, and how probable it is."""

from __future__ import annotations

from typing import Any

import numpy as np

from cablesense_gap.report.figure_style import (
    AFTER,
    FLOOR,
    LEAST_N,
    OTHER,
    WIDTH_IN,
    as_uri,
    plain_log_ticks,
)
from cablesense_gap.report.numbers import percent
from cablesense_gap.report.wording import candidate_name
from cablesense_gap.verdict import Verdict

MOST = 12


def candidate_figure(verdict: Verdict) -> str:
    """The most probable candidates, the verdict's in colour, as the `src` of an image."""
    return as_uri(drawn_candidates(verdict))


def drawn_candidates(verdict: Verdict) -> Any:
    """The same as a matplotlib figure."""
    import matplotlib.pyplot as plt

    shown = verdict.ranked[:MOST]
    y = np.arange(len(shown))
    figure, (left, right) = plt.subplots(
        1,
        2,
        figsize=(WIDTH_IN, 1.05 + 0.27 * len(shown)),
        sharey=True,
        width_ratios=(1.25, 1.0),
        layout="constrained",
    )
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
    left.set_xlabel("RMS left on held-out trials, N (logarithmic)")
    right.set(xlabel="probability", xlim=(0.0, 1.12), xticks=(0.0, 0.25, 0.5, 0.75, 1.0))
    for axes in (left, right):
        axes.tick_params(axis="y", length=0)
        axes.grid(axis="x")
    return figure
