"""Bars that a page draws itself, so that they can be read at any width: what the gap consists of.

`charts.html` has the macros that draw them; every template can import it.
"""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

from cablesense_gap.report.style import size_text
from cablesense_gap.report.text import (
    Known,
    candidate_name,
    causes_and_advice,
    headline,
    rival_names,
)
from cablesense_gap.verdict import NONE, UNKNOWN, Verdict, listed

Kind = Literal["before", "after", "other", "floor"]


class Bar(NamedTuple):
    """One bar, from `low` to `high` in the verdict's unit, with a text."""

    name: str
    low: float
    high: float
    kind: Kind
    text: str


def gap_bars(verdict: Verdict) -> list[Bar]:
    """The nominal gap, that with the effects alone, that with tolerances too, and the floor."""
    gap = verdict.gap
    sizes: list[tuple[str, float, Kind]] = [("nominal", gap.before_n, "before")]
    if gap.effects_n is not None:
        effects = listed([candidate_name((name,)) for name in verdict.effects])
        sizes.append((f"with {effects} alone", gap.effects_n, "after"))
        sizes.append(("with tolerances as well", gap.after_n, "after"))
    elif verdict.effects == (UNKNOWN,):
        sizes.append(("with a flexible correction", gap.after_n, "other"))
    else:
        sizes.append(("with tolerances as fitted", gap.after_n, "other"))
    sizes.append(("sensors alone", gap.floor_n, "floor"))
    return [Bar(name, 0.0, n, kind, size_text(n, verdict.unit)) for name, n, kind in sizes]


def steps(verdict: Verdict) -> list[Bar]:
    """Steps from the nominal gap down to the floor, one for each of several effects."""
    if len(verdict.shares) < 2:
        return []
    gap, unit, level = verdict.gap, verdict.unit, verdict.gap.before_n
    bars = [Bar("nominal", 0.0, level, "before", size_text(level, unit))]
    ends: list[tuple[str, float, Kind]] = [
        (candidate_name((name,)), share.left_n, "after") for name, share in verdict.shares.items()
    ]
    ends += [
        ("tolerances", gap.after_n, "other"),
        ("unexplained", min(gap.floor_n, gap.after_n), "other"),
    ]
    for name, left, kind in ends:
        low, high = sorted((level, left))
        bars.append(Bar(name, low, high, kind, _signed(left - level, unit)))
        level = left
    return [*bars, Bar("sensors alone", 0.0, gap.floor_n, "floor", size_text(gap.floor_n, unit))]


def _signed(change: float, unit: str) -> str:
    size = size_text(abs(change), unit)
    return size if change >= 0.0 or size == size_text(0.0, unit) else f"\N{MINUS SIGN}{size}"


def common_content(verdict: Verdict, known: Known | None = None) -> dict[str, Any]:
    """What `layout.html` and the budget show; `known` are the effects of an arm by default."""
    alone = verdict.effects[0] in (NONE, UNKNOWN)
    return {
        "kind": verdict.effects[0] if alone else "effect",
        "headline": headline(verdict, known),
        "rivals": rival_names(verdict),
        "causes": [] if alone else causes_and_advice(verdict, known),
        "verdict": verdict,
        "bars": gap_bars(verdict),
        "steps": steps(verdict),
    }
