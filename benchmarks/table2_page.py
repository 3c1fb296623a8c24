"""The page on Table II: pictures, tables and the sentences of `cablesense_gap.table2`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from cablesense_gap.report.pictures import candidate_picture
from cablesense_gap.report.style import as_uri, newtons, page_css, percent, style
from cablesense_paper.table_2_gap import Findings
from cablesense_paper.table_2_text import (
    best_listed_n,
    gap_figure,
    loads,
    named_tables,
    number_name,
    paper_figure,
    paper_rows,
    proportion_figure,
    resolution,
    shares,
    slack_cable,
    value_of,
)


def page(found: Findings) -> str:
    """The report as HTML that needs nothing beside it."""
    from jinja2 import Environment, StrictUndefined

    with style():
        pictures = {
            "gap": as_uri(gap_figure(found)),
            "proportion": as_uri(proportion_figure(found)),
            "candidates": candidate_picture(found.verdict),
            "paper": as_uri(paper_figure(found)),
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
            f"two, to {newtons(best_listed_n(found))} on rows that they were not fitted to."
        ),
        "arm": found.arm.name,
        "tiles": [
            (percent(verdict.probability), "sure that no listed effect, nor two, make it"),
            (newtons(gap.before_n), "gap to our simulation"),
            (newtons(best_listed_n(found)), "left by the best one or two listed effects"),
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
