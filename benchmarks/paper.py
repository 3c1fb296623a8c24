"""How long `cablesense paper` takes, study by study, what agrees, and the README's pictures of it.

    python benchmarks/paper.py [--quick] [--made DIR] [--write]

Runs the command as a user would, or takes the report that it has left in DIR. `--write` puts the
numbers into `results/paper.json`, those of the full and of the quick run beside each other, and,
of a full run, three of its pictures into `docs/images/`.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

from harness import CABLESENSE, RESULTS, origin, parser, write_result
from PIL import Image

IMAGES = Path(__file__).parents[1] / "docs" / "images"
PICTURES = {
    "table_2_loads": "paper_table_2",
    "fig_12_error_against_force": "paper_error",
    "fig_6_hysteresis": "paper_friction",
}
"""Of the report, by the names that the README calls them."""

WIDTH_PX, COLOURS = 1530, 128
BAR_QUICK_S = 120.0


def main() -> int:
    """Measures, prints, and exits 1 where a study failed or the quick mode missed its bar."""
    options_of = parser(__doc__, "paper.json and pictures")
    options_of.add_argument("--quick", action="store_true", help="the quick mode")
    options_of.add_argument("--made", type=Path, help="folder of a report made before")
    options = options_of.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder, wall_s = options.made or Path(temporary), None
        if options.made is None:
            quick, began = ["--quick"] if options.quick else [], time.perf_counter()
            subprocess.run([*CABLESENSE, "paper", *quick, "--out", folder], check=False)
            wall_s = round(time.perf_counter() - began, 1)
        report = json.loads((folder / "results.json").read_text(encoding="utf-8"))
        result = _summary(report["studies"], wall_s)
        if options.write and not report["quick"]:
            _write_pictures(folder)
    print(json.dumps(result, indent=1, ensure_ascii=False))
    if options.write:
        path = RESULTS / "paper.json"
        known = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
        write_result(path.name, {**known, "quick" if report["quick"] else "full": result})
    missed = report["quick"] and result["seconds"] > BAR_QUICK_S
    return 1 if missed or result["failed"] else 0


def _summary(studies: list[dict[str, Any]], wall_s: float | None) -> dict[str, Any]:
    """Seconds are the studies' own, and the command's where it was run here."""
    agreements = Counter(
        comparison["agreement"]
        for study in studies
        for comparison in study.get("comparisons", ())
        if comparison["source"] == "the paper"
    )
    return {
        **origin(),
        "load_average_at_the_end": os.getloadavg()[0],
        "seconds": round(sum(study["seconds"] for study in studies), 1),
        "seconds_of_the_command": wall_s,
        "seconds_by_study": {study["name"]: study["seconds"] for study in studies},
        "agreements_with_the_paper": dict(agreements),
        "failed": [study["name"] for study in studies if study["failure"]],
    }


def _write_pictures(folder: Path) -> None:
    for name, shown in PICTURES.items():
        with Image.open(folder / f"{name}.png") as image:
            height = round(image.height * WIDTH_PX / image.width)
            small = image.convert("RGB").resize((WIDTH_PX, height), Image.Resampling.LANCZOS)
        small.quantize(COLOURS).save(IMAGES / f"{shown}.png", optimize=True)


if __name__ == "__main__":
    sys.exit(main())
