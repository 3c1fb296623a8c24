"""Pictures of one arm from its recording to its repaired estimator, for docs/diagnosis.md.

    python benchmarks/gap_case.py DIR/arm_002 [--write]

Takes an arm that `gap_adapt.py --folder DIR` has gone through, makes its report, and photographs
parts of it in a headless Chromium.
"""

from __future__ import annotations

import json
import pickle
import re
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path

import harness
from gap_adapt import ARM
from PIL import Image, ImageChops

from cablesense_base.installation import config_path
from cablesense_gap.pipeline import Diagnosis
from cablesense_gap.recorded_contacts import recorded_errors
from cablesense_gap.recordings.checks import read_recording
from cablesense_gap.report.page import report_page
from cablesense_gap.verdict import Estimator
from cablesense_training.inference.temporal_estimator import open_estimator

IMAGES = Path(__file__).parents[1] / "docs" / "images"
PARTS = {
    "case_budget.png": ("", "The budget"),
    "case_estimator.png": ("What it does to the force estimator",),
}
"""Sections of the report by their headings, the head of the page by an empty one."""
_WIDTH, _HEIGHT, _MARGIN = 900, 3000, 16


def main() -> None:
    """Makes the report and photographs it; with `--write` into docs/images/."""
    parser = harness.parser(__doc__, "docs/images/case_*.png")
    parser.add_argument("folder", type=Path, help="of one arm")
    options = parser.parse_args()
    page = _report(options.folder)
    target = IMAGES if options.write else options.folder
    (options.folder / "report.html").write_text(page, encoding="utf-8")
    for name, headings in PARTS.items():
        _photograph(_only(page, headings), target / name)
        print(target / name)


def _report(folder: Path) -> str:
    found: Diagnosis = pickle.loads((folder / "diagnosis.pickle").read_bytes())
    case = json.loads(folder.with_suffix(".json").read_text(encoding="utf-8"))
    errors = Estimator.model_validate({key: case[key] for key in Estimator.model_fields})
    (path,) = folder.glob("case_*.csv")
    recording = read_recording(path, found.nominal)
    files = {"before": config_path(f"models/{ARM}.onnx"), "after": folder / "estimator.onnx"}
    models = {
        name: recorded_errors(recording, open_estimator(file), errors.trials)
        for name, file in files.items()
    }
    verdict = found.verdict.model_copy(update={"estimator": errors})
    return report_page(replace(found, verdict=verdict), models)


def _only(page: str, headings: tuple[str, ...]) -> str:
    """The page with some of its sections alone."""
    before, main, after = re.split(r"(?<=<main>)|(?=</main>)", page, maxsplit=2)
    sections = re.split(r"(?=<h2>)", main)
    kept = [
        section
        for section in sections
        for title in ["".join(re.findall(r"^<h2>(.*?)</h2>", section))]
        if title in headings
    ]
    return before + "".join(kept) + after


def _photograph(page: str, path: Path) -> None:
    with tempfile.TemporaryDirectory() as name:
        html, shot = Path(name) / "page.html", Path(name) / "shot.png"
        html.write_text(page, encoding="utf-8")
        command = ["chromium", "--headless", "--no-sandbox", "--hide-scrollbars"]
        command += [f"--window-size={_WIDTH},{_HEIGHT}", f"--screenshot={shot}", html.as_uri()]
        subprocess.run(command, check=True, capture_output=True, timeout=120)
        image = Image.open(shot).convert("RGB")
        blank = Image.new("RGB", image.size, image.getpixel((0, _HEIGHT - 1)))
        box = ImageChops.difference(image, blank).getbbox()
        assert box is not None
        image.crop((0, 0, _WIDTH, min(box[3] + _MARGIN, _HEIGHT))).save(path, optimize=True)


if __name__ == "__main__":
    main()
