"""The folder that a diagnosis leaves: verdict, amended arm and report."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from cablesense_base.files import write_atomically
from cablesense_gap.amended_arm import AMENDED_ARM, write_arm
from cablesense_gap.arm_system import Diagnosis
from cablesense_gap.recorded_contacts import RecordedErrors
from cablesense_gap.report.charts import common_content
from cablesense_gap.report.pictures import (
    arm_picture,
    drawn_errors,
    dumbbell_picture,
    overlay_picture,
    time_picture,
)
from cablesense_gap.report.style import (
    ReportError,
    as_uri,
    newtons,
    percent,
    rendered,
    style,
)
from cablesense_gap.report.text import (
    FRICTION_HIDES,
    SURE,
    candidate_name,
    earlier_sentence,
    effect_places,
    error_rows,
    headline,
    numbers,
    place_text,
)
from cablesense_gap.residuals import ALL, CABLE, EVERYWHERE, LOOP, REGIMES, SET, TRIAL, decompose
from cablesense_gap.verdict import (
    NONE,
    UNKNOWN,
    Verdict,
    VerdictError,
    listed,
    write_verdict,
)

DIAGNOSIS_FILES = ("verdict.json", AMENDED_ARM, "report.html")

_WORST = 8
"""Parts of the remaining gap that are shown at first."""


def write_diagnosis(
    folder: Path, found: Diagnosis, models: Mapping[str, RecordedErrors] = MappingProxyType({})
) -> None:
    """Write all three files, each whole or not at all; `models` as `report_page` takes them.

    Raises:
        VerdictError: the folder cannot be made, or the verdict not be written.
        ArmFileError: the arm file cannot be written.
        ReportError: the report cannot be written.
    """
    make_folder(folder)
    verdict, arm, report = (folder / name for name in DIAGNOSIS_FILES)
    write_verdict(verdict, found.verdict)
    write_arm(arm, found.amended, headline(found.verdict))
    write_atomically(report, report_page(found, models), ReportError)


def make_folder(folder: Path) -> None:
    """Make the folder of a diagnosis where there is none.

    Raises:
        VerdictError: it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise VerdictError(f"{folder}: cannot be made ({error.strerror or error})") from error


def report_page(
    found: Diagnosis, models: Mapping[str, RecordedErrors] = MappingProxyType({})
) -> str:
    """The report as one self-contained HTML page.

    `models` are errors of estimators by their names, which a picture shows side by side.
    """
    verdict, recording = found.verdict, found.recording
    floor_n = verdict.gap.floor_n
    before = decompose(recording, found.before_n, floor_n, found.nominal)
    after = decompose(recording, found.after_n, floor_n, found.nominal)
    parts = [part for part in after.parts if part.group not in (ALL, TRIAL)]
    with style():
        pictures = {
            "arm": arm_picture(found.nominal, _marked(verdict)),
            "overlay": overlay_picture(found),
            "time": time_picture(found),
            "cable": dumbbell_picture(before, after, found.after_label, (CABLE,)),
            "set": dumbbell_picture(before, after, found.after_label, (SET,)),
            "regime": dumbbell_picture(before, after, found.after_label, (*REGIMES, LOOP)),
            "estimator": as_uri(drawn_errors(models), "png") if models else "",
        }
    content = {
        **common_content(verdict),
        "sure": verdict.probability >= SURE,
        "recording": recording,
        "uncounted": int((~found.counted).sum()),
        "trials": len(set(recording.trial.tolist())),
        "arm": found.nominal,
        "places": place_text(verdict.where.places),
        "everywhere": EVERYWHERE,
        "pictures": pictures,
        "numbers": numbers(verdict, found.nominal),
        "before": before,
        "after": after,
        "changed": found.after_label != "",
        "worst": sorted(parts, key=lambda part: -part.over_floor)[:_WORST],
        "findings": found.findings,
        "errors": error_rows(verdict.estimator) if verdict.estimator else [],
        "hidden": FRICTION_HIDES if "capstan_friction" in verdict.effects else "",
    }
    filters: dict[str, Any] = {
        made.__name__: made for made in (newtons, percent, listed, earlier_sentence)
    }
    return rendered("cablesense_gap.report", "report.html", content, filters)


def _marked(verdict: Verdict) -> dict[str, tuple[str, ...]]:
    """Places by cause, as the picture of the arm marks them."""
    if verdict.effects == (UNKNOWN,):
        return {"where the gap is": verdict.where.places}
    return {
        candidate_name((name,)): effect_places(verdict, name)
        for name in verdict.effects
        if name != NONE
    }
