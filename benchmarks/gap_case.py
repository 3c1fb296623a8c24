"""Pictures of reports: an arm from its recording to its repaired estimator, and a robot.

    cablesense gap withhold --count 1 --seed 9401002 --out cases
        --only contact_offset+joint_elasticity+sensor_lag
    cablesense gap adapt cases/case_001.csv --arm cdsm_lab --out adapted
    python benchmarks/gap_case.py adapted [--write]

    python benchmarks/real_double_pendulum.py --data DIR --design C.1 --report reports
    python benchmarks/gap_case.py reports/c1 --robot [--write]

Photographs parts of the report in a headless Chromium.
"""

from __future__ import annotations

import re
import subprocess
import tempfile
from pathlib import Path

import harness
from PIL import Image, ImageChops

IMAGES = Path(__file__).parents[1] / "docs" / "images"
PARTS = {
    "case_budget.png": ("", "The budget"),
    "case_estimator.png": ("What it does to the force estimator",),
}
PARTS_OF_A_ROBOT = {"robot_report.png": ("", "What to do next")}
"""Sections of the report by their headings, the head of the page by an empty one."""
_WIDTH, _HEIGHT, _MARGIN = 900, 3000, 16


def main() -> None:
    """Photographs into the folder itself; with `--write` into docs/images/."""
    parser = harness.parser(__doc__, "docs/images/")
    parser.add_argument("folder", type=Path, help="of a report")
    parser.add_argument("--robot", action="store_true", help="whether it is of a robot")
    options = parser.parse_args()
    page = (options.folder / "report.html").read_text(encoding="utf-8")
    for name, headings in (PARTS_OF_A_ROBOT if options.robot else PARTS).items():
        path = (IMAGES if options.write else options.folder) / name
        _photograph(_only(page, headings), path)
        print(path)


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
