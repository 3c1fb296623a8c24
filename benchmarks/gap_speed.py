"""Time and memory of one diagnosis, in a process with two workers as a user runs it.

python benchmarks/gap_speed.py [--seed 7] [--hidden cable_creep] [--write]
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import harness
from gap_blind import ARM, drawn

from cablesense_gap.verdict import read_verdict

WORKERS = 2


def main() -> None:
    """Makes the recording, diagnoses it, prints; keeps the numbers with `--write`."""
    parser = harness.parser(__doc__, "results/gap_speed.json")
    parser.add_argument("--seed", type=int, default=7, help="of the plant")
    parser.add_argument("--hidden", default="cable_creep", help="what is hidden in the recording")
    options = parser.parse_args()
    loads = [round(load, 1) for load in os.getloadavg()]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        answer = drawn(folder, 1, options.seed, (options.hidden,))["case_001"]
        command = [*harness.CABLESENSE, "gap", "diagnose", str(folder / "case_001.csv")]
        command += ["--arm", ARM, "--out", str(folder / "out"), "--workers", str(WORKERS)]
        seconds, peak_mb = harness.run_watched(command)
        verdict = read_verdict(folder / "out" / "verdict.json")
    result = {
        **harness.origin(),
        "load_average_before": loads,
        "rows": verdict.rows,
        "hidden": {key: getattr(answer, key) for key in ("effects", "where", "form")}
        | {"gap_n": f"{answer.gap_n:.4f}"},
        "diagnosis": {
            "workers": WORKERS,
            "seconds": round(seconds, 1),
            "peak_memory_mb": round(peak_mb),
            "effects": list(verdict.effects),
            "probability": round(verdict.probability, 3),
            "gap_before_n": round(verdict.gap.before_n, 4),
            "gap_after_n": round(verdict.gap.after_n, 4),
            "gap_floor_n": round(verdict.gap.floor_n, 4),
        },
    }
    harness.publish("gap_speed.json", result, options)


if __name__ == "__main__":
    main()
