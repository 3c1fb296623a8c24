"""The commands of a diagnosis on arm files drawn at random: how many run, and are right.

    python benchmarks/gap_arms.py [--count 30] [--seed 9615] [--write]

Draws arms of 2 to 6 segments with 3 or 4 cables each, of 5 kN/m to 10 MN/m, as `cablesense info`
accepts them. Their files state the tolerances that the plant scatters by. On each it runs `gap
protocol`, `gap withhold` with one effect (all come in turn), `train` with few samples and `gap
diagnose`, as a user does. A command ran if it ends with 0 and warns of nothing; a verdict is right
if it names the effect alone. `--folder` keeps the files and continues there; `--minutes` starts no
further arm after that time. Arms 9 and 10 of seed 9601, 1 of 9602 and of 9604, 5 of 9603, and
those of 9605 to 9614, 9700 and 9701 were looked at while the diagnosis was made. Those of 9610 to
9612 and 9615 were looked at after the measurement.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import harness
import numpy as np
import yaml
from blind_sets import NARROW

from cablesense_gap.amended_arm import write_arm
from cablesense_gap.scoring import read_answers
from cablesense_gap.verdict import read_verdict
from cablesense_plants.arm.listed import LISTED
from cablesense_plants.cases import in_turn
from cablesense_sim.arm import Arm, parse_arm
from cablesense_sim.load_capacity import WeakArmError, load_capacity

PLANTS = [sys.executable, "-m", "cablesense_plants"]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
RATES_HZ = (5.0, 10.0, 20.0)
COMMANDS = {
    "protocol": "gap protocol --out protocol.csv",
    "record": "--count 1 --seed {seed} --only {kind} --out cases",
    "train": "train --samples 512 --epochs 2 --out model.onnx",
    "diagnose": "gap diagnose cases/case_001.csv --out diagnosis",
}


def main() -> None:
    """Runs the commands on every arm, counts and prints; keeps the counts with `--write`."""
    parser = harness.parser(__doc__, "gap_arms.json")
    parser.add_argument("--count", type=int, default=30, help="arms")
    parser.add_argument("--seed", type=int, default=9615, help="of arms, effects and recordings")
    parser.add_argument("--minutes", type=float, default=np.inf, help="then no further arm")
    parser.add_argument("--folder", type=Path, help="of the files, continued there")
    options = parser.parse_args()
    folder = options.folder or Path(tempfile.mkdtemp(prefix="gap_arms_"))
    kinds = in_turn(np.random.default_rng(options.seed), list(LISTED))
    until = time.time() + 60.0 * options.minutes
    cases = []
    for index in range(1, options.count + 1):
        kind = next(kinds)
        arm_folder = folder / f"arm_{index:03d}"
        if time.time() < until or (arm_folder / "diagnosis").exists():
            cases.append(
                _case(arm_folder, np.random.default_rng([options.seed, index]), index, kind)
            )
            print(cases[-1], flush=True)
    ran = {name: sum(name not in case["failed"] for case in cases) for name in COMMANDS}
    counts = {"arms": len(cases), "ran": ran, "right": sum(case["right"] for case in cases)}
    result = {**harness.origin(), "seed": options.seed, **counts, "each_case": cases}
    harness.publish("gap_arms.json", result, options)


def draw_arm(rng: np.random.Generator) -> Arm:
    """An arm that stands and bears contacts, its holes evenly around the axis."""
    while True:
        count = int(rng.integers(2, 7))
        per_segment = int(rng.integers(3, 5))
        length_m = rng.uniform(0.06, 0.25, count).round(3) * np.ones(count)
        offset_m = round(float(rng.uniform(0.1, 0.2) * length_m.min()), 3)
        arm = {
            "name": "drawn",
            "gravity_m_s2": [0.0, 0.0, -9.81],
            "segments": {
                "count": count,
                "length_m": length_m.tolist(),
                "mass_kg": _log_uniform(rng, 0.05, 1.0),
                "plate_offset_m": offset_m,
                "contact_m": (0.5 * length_m).round(3).tolist(),
            },
            "cables": {
                "per_segment": per_segment,
                "routing_radius_m": round(float(rng.uniform(0.02, 0.07)), 3),
                "angle_deg": {
                    "per_segment": 360.0 / per_segment / count,
                    "per_cable": -360.0 / per_segment,
                },
                "stiffness_n_m": _log_uniform(rng, 5e3, 1e7),
                "pretension_n": _log_uniform(rng, 10.0, 200.0),
                "run_m": 0.2,
            },
            "actuators": {"kind": "position", "kp_n_m": float("inf")},
            "sensors": {
                "place": "actuator end",
                "rate_hz": float(rng.choice(RATES_HZ)),
                "noise_std_n": _log_uniform(rng, 0.02, 0.2),
                "step_n": 0.05,
            },
            "tolerances": NARROW.model_dump(),
        }
        drawn = parse_arm(yaml.safe_dump(arm))
        try:
            load_capacity(drawn)
        except WeakArmError:
            continue
        return drawn


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(f"{np.exp(rng.uniform(np.log(low), np.log(high))):.3g}")


def _case(folder: Path, rng: np.random.Generator, index: int, kind: str) -> dict[str, Any]:
    """The failed commands on one arm, its hidden effect and the named one."""
    arm = draw_arm(rng)
    folder.mkdir(parents=True, exist_ok=True)
    write_arm(folder / "arm.yaml", arm, "")
    failed: dict[str, str] = {}
    for name, line in COMMANDS.items():
        words = line.format(seed=index, kind=kind).split()
        made = folder / words[words.index("--out") + 1]
        if made.exists():
            continue
        program = PLANTS if name == "record" else harness.CABLESENSE
        command = [*program, *words, "--arm", "arm.yaml"]
        done = subprocess.run(
            command, cwd=folder, env=ENVIRONMENT, capture_output=True, text=True, check=False
        )
        if done.returncode or "Warning" in done.stderr:
            failed[name] = done.stderr.strip()[-300:]
    verdict_file = folder / "diagnosis" / "verdict.json"
    answers = folder / "cases/answers/answers.csv"
    named = "+".join(read_verdict(verdict_file).effects) if verdict_file.exists() else ""
    return {
        "case": f"{index:03d}, {arm.segment_count} x {arm.cables.per_segment}",
        "stiffness_n_m": arm.cables.stiffness_n_m,
        "hidden": kind,
        "gap_over_floor": read_answers(answers)[0].gap_over_floor if answers.exists() else None,
        "named": named,
        "right": named == kind,
        "failed": failed,
    }


if __name__ == "__main__":
    main()
