"""How long `cablesense paper` takes, study by study, what agrees, and the README's pictures of it.

    python benchmarks/paper.py [--quick] [--made DIR] [--write]

Runs the command as a user would, or takes the report that it has left in DIR. `--write` puts the
figures into `results/paper.json`, those of the full and of the quick run beside each other, and,
of a full run, three of its pictures into `docs/images/`.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

from PIL import Image

HERE = Path(__file__).parent
RESULTS = HERE / "results" / "paper.json"
IMAGES = HERE.parent / "docs" / "images"
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
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="the quick mode")
    parser.add_argument("--made", type=Path, help="folder of a report made before")
    parser.add_argument("--write", action="store_true", help=f"write {RESULTS.name} and pictures")
    options = parser.parse_args()
    command = ["paper", *(["--quick"] if options.quick else [])]
    with tempfile.TemporaryDirectory() as temporary:
        folder, began = options.made or Path(temporary), time.perf_counter()
        if options.made is None:
            program = Path(sys.executable).with_name("cablesense")
            subprocess.run([program, *command, "--out", folder], check=False)
        wall_s = time.perf_counter() - began
        report = json.loads((folder / "results.json").read_text(encoding="utf-8"))
        result = _figures(report, None if options.made else wall_s)
        if options.write and not report["quick"]:
            _pictures(folder)
    print(json.dumps(result, indent=1, ensure_ascii=False))
    mode = "quick" if report["quick"] else "full"
    if options.write:
        known = json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else {}
        text = json.dumps({**known, mode: result}, indent=1, ensure_ascii=False)
        RESULTS.write_text(text + "\n", encoding="utf-8")
    missed = report["quick"] and result["seconds"] > BAR_QUICK_S
    return 1 if missed or result["failed"] else 0


def _figures(report: dict[str, Any], wall_s: float | None) -> dict[str, Any]:
    """Seconds are the studies' own, and the command's where it was run here."""
    studies = report["studies"]
    agreements = Counter(
        comparison["agreement"]
        for study in studies
        for comparison in study.get("comparisons", ())
        if comparison["source"] == "the paper"
    )
    return {
        "command": "python " + " ".join(["benchmarks/paper.py", *sys.argv[1:]]),
        "machine": f"{platform.machine()}, {os.cpu_count()} CPUs, "
        f"Python {platform.python_version()}",
        "load_average_at_the_end": os.getloadavg()[0],
        "seconds": round(sum(study["seconds"] for study in studies), 1),
        "seconds_of_the_command": None if wall_s is None else round(wall_s, 1),
        "seconds_by_study": {study["name"]: study["seconds"] for study in studies},
        "agreements_with_the_paper": dict(agreements),
        "failed": [study["name"] for study in studies if study["failure"]],
    }


def _pictures(folder: Path) -> None:
    for name, shown in PICTURES.items():
        with Image.open(folder / f"{name}.png") as image:
            height = round(image.height * WIDTH_PX / image.width)
            small = image.convert("RGB").resize((WIDTH_PX, height), Image.Resampling.LANCZOS)
        small.quantize(COLOURS).save(IMAGES / f"{shown}.png", optimize=True)


if __name__ == "__main__":
    sys.exit(main())
