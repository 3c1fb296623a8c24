"""The folder of a report: `report.html`, `results.json` and the pictures."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from cablesense_gap.report.page_file import write_whole
from cablesense_gap.report.report_error import ReportError
from cablesense_paper.page import paper_page
from cablesense_paper.paper_error import PaperError
from cablesense_paper.running import Outcome


def claim_folder(folder: Path) -> None:
    """Make the folder before anything runs, so that a wrong place costs no time.

    Raises:
        PaperError: it holds something, or cannot be made or written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise PaperError(f"{folder}: is not empty; give a new --out, or empty it")
        trial = folder / ".writable"
        trial.touch()
        trial.unlink()
    except OSError as error:
        reason = error.strerror or error
        raise PaperError(
            f"{folder}: cannot be written to ({reason}); give another --out"
        ) from error


def write_report(folder: Path, outcomes: Sequence[Outcome], quick: bool) -> None:
    """Write all files.

    Raises:
        ReportError: the place cannot be written to.
    """
    for outcome in outcomes:
        for picture in outcome.result.pictures if outcome.result else ():
            path = folder / f"{picture.name}.png"
            try:
                path.write_bytes(picture.png)
            except OSError as error:
                reason = error.strerror or error
                raise ReportError(f"{path}: cannot be written ({reason})") from error
    write_whole(folder / "results.json", results_json(outcomes, quick))
    write_whole(folder / "report.html", paper_page(outcomes, quick))


def results_json(outcomes: Sequence[Outcome], quick: bool) -> str:
    """All figures of a report as JSON text: what the page shows, pictures by file name."""
    studies = [_as_json(outcome, quick) for outcome in outcomes]
    return json.dumps({"quick": quick, "studies": studies}, indent=1, ensure_ascii=False) + "\n"


def _as_json(outcome: Outcome, quick: bool) -> dict[str, Any]:
    study, result = outcome.study, outcome.result
    said: dict[str, Any] = {
        "name": study.name,
        "title": study.title,
        "place": study.place,
        "seconds": round(outcome.seconds, 2),
        "reduced": study.quick if quick else "",
        "failure": outcome.failure,
    }
    if result is None:
        return said
    return said | {
        "lead": result.lead,
        "pictures": [
            {"file": f"{picture.name}.png", "caption": picture.caption}
            for picture in result.pictures
        ],
        "tables": [asdict(table) for table in result.tables],
        "comparisons": [asdict(comparison) for comparison in result.comparisons],
        "notes": list(result.notes),
    }
