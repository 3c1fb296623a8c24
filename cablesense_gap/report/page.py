"""The folder that a diagnosis leaves: `verdict.json`, `arm.yaml` and `report.html`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cablesense_base.files import write_atomically
from cablesense_gap.arm_simulator import write_arm
from cablesense_gap.pipeline import Diagnosis
from cablesense_gap.report.pictures import (
    MOST,
    cable_picture,
    drawn_candidates,
    dumbbell_picture,
    time_picture,
)
from cablesense_gap.report.style import (
    ReportError,
    as_uri,
    newtons,
    percent,
    rendered,
    style,
    with_interval,
)
from cablesense_gap.report.text import (
    all_places,
    ambiguity,
    effect_places,
    headline,
    place_text,
    regime_text,
    shrinkage,
    steps,
)
from cablesense_gap.residuals import ALL, LOOP, REGIMES, SET, TRIAL, decompose
from cablesense_gap.verdict import NONE, UNKNOWN, Verdict, VerdictError, write_verdict

_WORST = 8
"""Parts of what remains that are shown before one asks for all."""


def write_diagnosis(folder: Path, found: Diagnosis) -> None:
    """Write all three files, each whole or not at all.

    Raises:
        VerdictError: the folder cannot be made, or the verdict not be written.
        ArmFileError: the arm file cannot be written.
        ReportError: the report cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise VerdictError(f"{folder}: cannot be made ({error.strerror or error})") from error
    write_verdict(folder / "verdict.json", found.verdict)
    write_arm(folder / "arm.yaml", found.amended, headline(found.verdict))
    write_atomically(folder / "report.html", report_page(found), ReportError)


def report_page(found: Diagnosis) -> str:
    """The report, one HTML page that needs nothing beside it."""
    filters = {"newtons": newtons, "percent": percent}
    return rendered("cablesense_gap.report", "report.html", _content(found), filters)


def _content(found: Diagnosis) -> dict[str, Any]:
    verdict, recording = found.verdict, found.recording
    floor_n = verdict.gap.floor_n
    before = decompose(recording, found.before_n, floor_n, found.nominal)
    after = decompose(recording, found.after_n, floor_n, found.nominal)
    parts = [part for part in after.parts if part.group not in (ALL, TRIAL)]
    with style():
        pictures = {
            "time": time_picture(found),
            "cable": cable_picture(before, after, found.after_label),
            "set": dumbbell_picture(before, after, found.after_label, (SET,)),
            "regime": dumbbell_picture(before, after, found.after_label, (*REGIMES, LOOP)),
            "candidates": as_uri(drawn_candidates(verdict)) if verdict.candidates else "",
        }
    return {
        "kind": "effect" if verdict.effects[0] not in (NONE, UNKNOWN) else verdict.effects[0],
        "headline": headline(verdict),
        "shrinkage": shrinkage(verdict),
        "ambiguity": ambiguity(verdict),
        "steps": steps(found),
        "verdict": verdict,
        "recording": recording,
        "trials": len(set(recording.trial.tolist())),
        "arm": found.nominal,
        "places": place_text(all_places(verdict)),
        "regimes": regime_text(verdict),
        "pictures": pictures,
        "hidden_candidates": max(0, len(verdict.candidates) - MOST),
        "parameters": _parameters(verdict),
        "estimator": _estimator(verdict),
        "before": before,
        "after": after,
        "changed": found.after_label != "",
        "worst": sorted(parts, key=lambda part: -part.over_floor)[:_WORST],
        "findings": found.findings,
    }


def _parameters(verdict: Verdict) -> list[dict[str, str]]:
    rows = []
    for name, estimate in verdict.parameters.items():
        effect, *middle, parameter = name.split(".")
        value, interval = with_interval(estimate)
        rows.append(
            {
                "effect": effect.replace("_", " "),
                "place": " ".join(middle or effect_places(verdict, effect)).replace("_", " "),
                "parameter": parameter,
                "value": value,
                "interval": interval,
                "unit": estimate.unit,
            }
        )
    return rows


def _estimator(verdict: Verdict) -> list[tuple[str, ...]]:
    if verdict.estimator is None:
        return []
    both = verdict.estimator.before, verdict.estimator.after
    return [
        (name, *(f"{each[name]:.4g}" if name in each else "–" for each in both))
        for name in both[0] | both[1]
    ]
