"""The tutorial's lines on arms that are drawn at random, as someone with an own arm types them.

    python benchmarks/tutorial_arms.py [--count 5] [--seed 9801] [--write]

Each arm takes the place of the edited template; its amplifier is read as rarely as the
tutorial's. All other lines are typed as they stand in docs/tutorial.md. An arm is right if every
line ends well, the hidden effect is named with exactly its cables, and the new estimator's error
is less than half.
"""

from __future__ import annotations

import csv
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import harness
import numpy as np
import yaml
from gap_arms import draw_arm

from cablesense_sim.arm import Arm
from tests.helpers.tutorial_page import PAGE, steps, typed

RATE_HZ = 2.0
"""Of the amplifier, as the tutorial sets it."""
MAKES_THE_FILE = ("cablesense info --template", "sed ")
"""Lines that write or edit the arm file."""
MOST_S = 360.0
"""From the arm file to the repaired estimator."""


def main() -> int:
    """Types the lines for each arm, prints; keeps the cases with `--write`."""
    parser = harness.parser(__doc__, "tutorial_arms.json")
    parser.add_argument("--count", type=int, default=5, help="arms")
    parser.add_argument("--seed", type=int, default=9801, help="of the arms")
    options = parser.parse_args()
    cases = []
    for index in range(options.count):
        arm = draw_arm(np.random.default_rng([options.seed, index]))
        with tempfile.TemporaryDirectory() as folder:
            cases.append(_case(arm, Path(folder)))
        print(cases[-1], flush=True)
    result = {
        "seed": options.seed,
        "each_case": cases,
        "bars": {
            "every arm is right": all(case["right"] for case in cases),
            f"every arm takes {MOST_S:g} s at most": all(case["s"] < MOST_S for case in cases),
        },
    }
    return harness.publish("tutorial_arms.json", result, options, "mujoco", "torch")


def _case(arm: Arm, folder: Path) -> dict[str, Any]:
    sensors = arm.sensors.model_copy(update={"rate_hz": RATE_HZ})
    drawn = arm.model_copy(update={"sensors": sensors})
    text = yaml.safe_dump(drawn.model_dump(mode="python"), sort_keys=False)
    (folder / "my_arm.yaml").write_text(text, encoding="utf-8")
    case: dict[str, Any] = {
        "segments": arm.segments.count,
        "cables": arm.cables.per_segment,
        "stiffness_n_m": arm.cables.stiffness_n_m,
        "right": False,
    }
    begun_s = time.monotonic()
    try:
        for step in steps(PAGE.read_text(encoding="utf-8")):
            lines = tuple(line for line in step.lines if not line.startswith(MAKES_THE_FILE))
            typed(lines, folder)
    except RuntimeError as error:
        return {**case, "s": time.monotonic() - begun_s, "failed": str(error)}
    case["s"] = round(time.monotonic() - begun_s, 1)
    verdict = json.loads((folder / "adapted/verdict.json").read_text(encoding="utf-8"))
    answers = (folder / "bench/answers/answers.csv").read_text(encoding="utf-8")
    (answer,) = csv.DictReader(answers.splitlines())
    errors = verdict["estimator"]
    before_n = errors["before"]["force_mae_n"]
    after_n = errors["after"]["force_mae_n"]
    named = verdict["effects"] == ["sensor_gain"]
    placed = verdict["where"]["cables"] == answer["where"].split()
    return {
        **case,
        "effects": verdict["effects"],
        "probability": verdict["probability"],
        "cables_right": placed,
        "force_mae_n": [before_n, after_n],
        "right": named and placed and after_n < 0.5 * before_n,
    }


if __name__ == "__main__":
    raise SystemExit(main())
