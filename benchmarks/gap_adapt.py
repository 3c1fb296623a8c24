"""Force estimators put right by `cablesense gap adapt`, on arms of the independent plant.

    python benchmarks/gap_adapt.py --folder DIR [--count 12] [--effects 2-5] [--seed 9401]
        [--minutes 7] [--write]

Draws arms with several effects, until so many of them mislead the shipped estimator by `--least`
newtons or more on their loads; each of these is adapted to. Errors before and after are those on
the trials of the recording that neither the diagnosis nor the training had. With the same folder
it goes on where it was stopped; after `--minutes` it begins no further arm, and reports those that
are done.
"""

from __future__ import annotations

import json
import os
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import harness
import numpy as np
from rich.console import Console

from cablesense_base.installation import config_path
from cablesense_gap.adaptation import adapt
from cablesense_gap.plant.body import read_nominal
from cablesense_gap.plant.withhold import draw_several, withhold
from cablesense_gap.recorded_contacts import recorded_errors
from cablesense_gap.recordings.checks import read_recording
from cablesense_gap.scoring import proportion
from cablesense_sim.arm import Arm, find_arm, open_arm
from cablesense_training.inference.estimator import Estimator

os.environ.setdefault("OMP_NUM_THREADS", "1")

RESULT = "gap_adapt.json"
ARM = "cdsm_lab"
_MOST_DRAWN = 200
_HIDDEN_BY = "capstan_friction"
"""The effect that may hide a contact."""

LOG = Console(stderr=True)


def main() -> None:
    """Draws, adapts and prints; keeps the figures with `--write`."""
    parser = harness.parser(__doc__, f"results/{RESULT}")
    parser.add_argument("--folder", type=Path, required=True, help="of arms; goes on there")
    parser.add_argument("--count", type=int, default=12, help="arms that are misled")
    parser.add_argument("--effects", default="2-5", help="how many in each arm, from-to")
    parser.add_argument("--seed", type=int, default=9401, help="of the plant")
    parser.add_argument("--least", type=float, default=2.0, help="newtons that are misled")
    parser.add_argument("--minutes", type=float, default=np.inf, help="then no further arm")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    least, most = map(int, options.effects.split("-"))
    kinds = draw_several(np.random.default_rng([options.seed]), _MOST_DRAWN, least, most)
    until = time.monotonic() + 60.0 * options.minutes
    cases: list[dict[str, Any]] = []
    for index, kind in enumerate(kinds, start=1):
        if sum("before" in case for case in cases) == options.count:
            break
        kept = options.folder / f"arm_{index:03d}.json"
        if not kept.exists():
            if time.monotonic() > until:
                break
            case = _case(options.folder / f"arm_{index:03d}", kind, index, options)
            kept.write_text(json.dumps(case))
        cases.append(json.loads(kept.read_text()))
    harness.publish(RESULT, {**harness.origin(), "arm": ARM, **_summary(cases)}, options)


def _case(folder: Path, kind: str, index: int, options: Any) -> dict[str, Any]:
    arm, seed = open_arm(ARM), 1000 * options.seed + index
    folder.mkdir(exist_ok=True)
    drawn = withhold(folder, folder / "answers.csv", read_nominal(find_arm(ARM)), 1, seed, (kind,))
    (answer,) = drawn
    shipped = config_path(f"models/{ARM}.onnx")
    recording = read_recording(folder / f"{answer.recording}.csv", arm)
    misled_n = _force_error_n(recording, shipped, arm)
    case = {"hidden": answer.effects, "gap_n": answer.gap_n, "misled_n": misled_n}
    LOG.print(f"{folder.name}: {answer.effects}, misled by {misled_n:.2f} N")
    if misled_n < options.least:
        return case
    began = time.monotonic()
    second = folder / "estimator.onnx"
    found = adapt(recording, arm, shipped, second, "cablesense gap adapt")
    estimator = found.diagnosis.verdict.estimator
    assert estimator is not None
    case |= {
        "named": list(found.diagnosis.verdict.effects),
        "unexplained_share": found.diagnosis.verdict.unexplained_share,
        "seconds": round(time.monotonic() - began, 1),
        "diagnosis_seconds": found.diagnosis.verdict.seconds,
        **estimator.model_dump(mode="json"),
    }
    LOG.print(case)
    return case


def _force_error_n(recording: Any, model: Path, arm: Arm) -> float:
    errors = recorded_errors(recording, Estimator.load(model, arm))
    return errors.whole.errors.magnitude_mae_n


def _summary(cases: list[dict[str, Any]]) -> dict[str, Any]:
    misled = [case for case in cases if "before" in case]
    used = [case["after"] if case["use"] == "after" else case["before"] for case in misled]
    left = [
        errors["force_mae_n"] / case["before"]["force_mae_n"]
        for case, errors in zip(misled, used, strict=True)
    ]
    seen = [
        errors["contact_accuracy"]
        for case, errors in zip(misled, used, strict=True)
        if _HIDDEN_BY not in case["hidden"].split("+")
    ]
    summary: dict[str, Any] = {"drawn": len(cases), "misled": len(misled)}
    if misled:
        summary |= {
            "halved": asdict(proportion(share <= 0.5 for share in left)),
            "force_error_left": harness.percentiles(left, ("median", "worst")),
            "least_contact_accuracy_without_friction": min(seen, default=None),
            "mean_interval_coverage": float(
                np.mean([errors.get("interval_coverage", 0.0) for errors in used])
            ),
            "seconds": harness.percentiles(
                [case["seconds"] for case in misled], ("median", "worst")
            ),
        }
    return {**summary, "cases": cases}


if __name__ == "__main__":
    main()
