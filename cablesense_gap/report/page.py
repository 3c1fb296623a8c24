"""Writes the report."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cablesense_gap.report.advice import steps
from cablesense_gap.report.candidate_figure import MOST, candidate_figure
from cablesense_gap.report.figure_style import style
from cablesense_gap.report.gap_figures import cable_figure, regime_figure, set_figure
from cablesense_gap.report.inputs import ReportInputs
from cablesense_gap.report.numbers import newtons, percent, with_interval
from cablesense_gap.report.page_file import rendered, write_whole
from cablesense_gap.report.time_figure import time_figure
from cablesense_gap.report.wording import (
    all_places,
    ambiguity,
    effect_places,
    headline,
    place_words,
    regime_words,
    shrinkage,
)
from cablesense_gap.residuals.decomposition import ALL, Decomposition, decompose
from cablesense_gap.residuals.row_groups import TRIAL
from cablesense_gap.verdict import NONE, UNKNOWN, Verdict

WORST = 8
"""Parts of what remains that are shown before one asks for all."""


def write_report(path: str | Path, inputs: ReportInputs) -> None:
    """Write the report, one HTML file that needs nothing beside it; whole or not at all.

    Raises:
        ReportError: the place cannot be written to.
    """
    write_whole(Path(path), report_page(inputs))


def report_page(inputs: ReportInputs) -> str:
    """The report as HTML text."""
    filters = {"newtons": newtons, "percent": percent}
    return rendered("cablesense_gap.report", "report.html", _content(inputs), filters)


def _content(inputs: ReportInputs) -> dict[str, Any]:
    verdict, recording = inputs.verdict, inputs.recording
    floor_n = verdict.gap.floor_n
    before = decompose(recording, inputs.before_n, floor_n, inputs.arm)
    after = decompose(recording, inputs.after_n, floor_n, inputs.arm)
    with style():
        pictures = {
            "time": time_figure(inputs),
            "cable": cable_figure(before, after, inputs.after_label),
            "set": set_figure(before, after, inputs.after_label),
            "regime": regime_figure(before, after, inputs.after_label),
            "candidates": candidate_figure(verdict) if verdict.candidates else "",
        }
    return {
        "kind": "effect" if verdict.effects[0] not in (NONE, UNKNOWN) else verdict.effects[0],
        "headline": headline(verdict),
        "shrinkage": shrinkage(verdict),
        "ambiguity": ambiguity(verdict),
        "steps": steps(inputs),
        "verdict": verdict,
        "recording": recording,
        "trials": len(set(recording.trial.tolist())),
        "arm": inputs.arm,
        "held_out": inputs.held_out_n is not None,
        "places": place_words(all_places(verdict)),
        "regimes": regime_words(verdict),
        "pictures": pictures,
        "hidden_candidates": max(0, len(verdict.candidates) - MOST),
        "parameters": _parameters(verdict),
        "estimator": _estimator(verdict),
        "before": before,
        "after": after,
        "changed": inputs.after_label != "",
        "worst": _worst(after),
        "findings": inputs.findings,
    }


def _parameters(verdict: Verdict) -> list[dict[str, str]]:
    rows = []
    for name, estimate in verdict.parameters.items():
        effect, *middle, parameter = name.split(".")
        value, interval = with_interval(estimate)
        where = middle or effect_places(verdict, effect)
        rows.append(
            {
                "effect": effect.replace("_", " "),
                "place": " ".join(where).replace("_", " "),
                "parameter": parameter,
                "value": value,
                "interval": interval,
                "unit": estimate.unit,
            }
        )
    return rows


def _estimator(verdict: Verdict) -> list[tuple[str, str, str]]:
    if verdict.estimator is None:
        return []
    before, after = verdict.estimator.before, verdict.estimator.after
    return [
        (name, _figure(before.get(name)), _figure(after.get(name)))
        for name in dict.fromkeys((*before, *after))
    ]


def _figure(value: float | None) -> str:
    return "–" if value is None else f"{value:.4g}"


def _worst(after: Decomposition) -> list[Any]:
    parts = [part for part in after.parts if part.group not in (ALL, TRIAL)]
    return sorted(parts, key=lambda part: -part.over_floor)[:WORST]
