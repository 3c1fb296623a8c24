"""The folder of a report: `report.html`, `results.json` and the pictures."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from cablesense_base.files import output_folder, write_atomically
from cablesense_gap.report.style import WIDTH_IN, ReportError, image_uri, rendered
from paper.study import PAPER, PRINT_DPI, Agreement, PaperError, Picture, StudyOutcome


def claim_folder(folder: Path, force: bool = False) -> None:
    """Make the folder before anything runs, so that a wrong place costs no time.

    Raises:
        PaperError: it holds something and not `force`, or cannot be made or written to.
    """
    output_folder(folder, ("report.html", "results.json", "*.png"), PaperError, force=True)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise PaperError(
            f"{folder}: cannot be made ({error.strerror}); give another --out"
        ) from error
    if not force and any(folder.iterdir()):
        raise PaperError(
            f"{folder}: is not empty; give a new --out, or replace its files with --force"
        )


def write_report(folder: Path, outcomes: Sequence[StudyOutcome], quick: bool) -> dict[str, Any]:
    """Write all files, each of them whole or not at all; gives the content of `results.json`.

    Raises:
        ReportError: the place cannot be written to.
    """
    results = {"quick": quick, "studies": [_as_json(outcome, quick) for outcome in outcomes]}
    files: dict[str, str | bytes] = {
        f"{picture.name}.png": picture.png
        for outcome in outcomes
        if outcome.result
        for picture in outcome.result.pictures
    }
    files["results.json"] = json.dumps(results, indent=1, ensure_ascii=False) + "\n"
    files["report.html"] = paper_page(outcomes, quick)
    for name, content in files.items():
        write_atomically(folder / name, content, ReportError)
    return results


def _as_json(outcome: StudyOutcome, quick: bool) -> dict[str, Any]:
    """The content of a study's page, pictures by file name."""
    study = outcome.study
    result = outcome.result
    about: dict[str, Any] = {
        "name": study.name,
        "title": study.title,
        "place": study.place,
        "seconds": round(outcome.seconds, 2),
        "reduced": study.quick if quick else "",
        "failure": outcome.failure,
    }
    if result is None:
        return about
    pictures = [
        {"file": f"{picture.name}.png", "caption": picture.caption} for picture in result.pictures
    ]
    return about | asdict(result) | {"pictures": pictures}


def paper_page(outcomes: Sequence[StudyOutcome], quick: bool) -> str:
    """The report as a self-contained HTML page."""
    comparisons = [c for outcome in outcomes if outcome.result for c in outcome.result.comparisons]
    content = {
        "quick": quick,
        "outcomes": [
            (outcome, [_embedded(p) for p in outcome.result.pictures] if outcome.result else [])
            for outcome in outcomes
        ],
        "failed": [outcome.study for outcome in outcomes if outcome.failure],
        "seconds": sum(outcome.seconds for outcome in outcomes),
        "agreements": list(Agreement),
        "with_paper": Counter(c.agreement for c in comparisons if c.source == PAPER),
        "otherwise": Counter(c.agreement for c in comparisons if c.source != PAPER),
    }
    return rendered("paper", "paper.html", content, {"figure": shown})


def shown(value: float | str) -> str:
    """A number to four digits, with a true minus sign; text as it is."""
    if isinstance(value, str):
        return value
    if value == 0.0 or 1e-3 <= abs(value) < 1e5:
        text = f"{value:.4g}"
    else:
        mantissa, _, exponent = f"{value:.3e}".partition("e")
        text = f"{mantissa.rstrip('0').rstrip('.')}e{int(exponent)}"
    return text.replace("-", "−")


def _embedded(picture: Picture) -> tuple[Picture, str, int]:
    """A picture, its data, and how much of the page's width it takes, in percent."""
    # a PNG has its width in pixels after 16 bytes of signature and header
    width_in = int.from_bytes(picture.png[16:20], "big") / PRINT_DPI
    return picture, image_uri(picture.png, "png"), min(100, round(100.0 * width_in / WIDTH_IN))
