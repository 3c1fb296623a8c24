"""The page on Table II: pictures, tables and the sentences of `table2_words`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from table2_words import (
    loads,
    named_tables,
    number_name,
    paper_rows,
    resolution,
    shares,
    slack_cable,
    value_of,
)

from cablesense_gap.report.candidate_figure import candidate_figure
from cablesense_gap.report.figure_style import (
    AFTER,
    BEFORE,
    GRID,
    INK,
    OTHER,
    WIDTH_IN,
    as_uri,
    style,
)
from cablesense_gap.report.numbers import newtons, percent
from cablesense_gap.report.page_file import page_css

if TYPE_CHECKING:
    from table2_gap import Findings

SETS = ("cables 1 to 3", "cables 4 to 6", "cables 7 to 9")
COLOURS = (BEFORE, AFTER, "#009E73")


def page(found: Findings) -> str:
    """The report as HTML that needs nothing beside it."""
    from jinja2 import Environment, StrictUndefined

    with style():
        pictures = {
            "gap": _gap_figure(found),
            "proportion": _proportion_figure(found),
            "candidates": candidate_figure(found.verdict),
            "paper": _paper_figure(found),
        }
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters.update(percent=percent)
    template = Path(__file__).with_suffix(".html").read_text(encoding="utf-8")
    return environment.from_string(template).render(pictures=pictures, **_content(found))


def _content(found: Findings) -> dict[str, Any]:
    gap, verdict = found.verdict.gap, found.verdict
    mistaken = sorted(found.rehearsal.mistaken.items(), key=lambda item: (-item[1], item[0]))
    inner = float((found.internal_n**2).sum() / (found.gap_n**2).sum())
    return {
        "css": page_css(),
        "headline": (
            f"Table II: no listed effect makes the gap of {newtons(gap.before_n)} "
            f"({percent(verdict.probability)} sure)."
        ),
        "lead": (
            f"{percent(inner)} of the gap's squares are forces among the cables that bend no "
            "joint. A law that only grows with the load shrinks it to "
            f"{newtons(gap.after_n)} on the other load level; the best listed effects, one or "
            f"two, to {newtons(_best_listed_n(found))} on rows that they were not fitted to."
        ),
        "arm": found.arm.name,
        "tiles": [
            (percent(verdict.probability), "sure that no listed effect, nor two, make it"),
            (newtons(gap.before_n), "gap to our simulation"),
            (newtons(_best_listed_n(found)), "left by the best one or two listed effects"),
            (newtons(gap.after_n), "left by a law in proportion to the load"),
            (newtons(gap.floor_n), "floor: noise and step"),
        ],
        "shares": shares(found),
        "moments": [
            (name, ["–" if np.isnan(v) else f"{100 * v:.0f} %" for v in row])
            for name, row in zip(loads(found), found.moments, strict=True)
        ],
        "slack": slack_cable(found),
        "singles": _singles(found),
        "why": verdict.why,
        "named": named_tables(found),
        "mistaken": [(*(n.replace("_", " ") for n in names), c) for names, c in mistaken],
        "resolution": resolution(found),
        "paper": paper_rows(found),
        "next": verdict.next_experiment,
        "command": found.command,
    }


def _best_listed_n(found: Findings) -> float:
    return min(
        c.held_out_rmse_n
        for c in found.verdict.candidates
        if c.effects[0] not in ("none", "unknown")
    )


def _singles(found: Findings) -> list[tuple[str, ...]]:
    by_row, by_point, by_level = found.singles.values()

    def of(group: Any, single: Any) -> str:
        key = single.number.effect, len(single.number.terms) > 1
        same = next(s for s in group if (s.number.effect, len(s.number.terms) > 1) == key)
        return newtons(same.held_out_rmse)

    return [
        (
            number_name(single.number),
            value_of(single),
            newtons(single.rmse),
            newtons(single.held_out_rmse),
            of(by_point, single),
            of(by_level, single),
        )
        for single in by_row
    ]


def _gap_figure(found: Findings) -> str:
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
    return as_uri(figure)


def _proportion_figure(found: Findings) -> str:
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
    return as_uri(figure)


def _paper_figure(found: Findings) -> str:
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
    return as_uri(figure)
