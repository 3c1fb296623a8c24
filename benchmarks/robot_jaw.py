"""The da Vinci jaw of `real_jaw.py` through the door of any robot: MJCFs and recordings.

    python benchmarks/robot_jaw.py --data DIR [--write]

Neither nominal model of `config/robots` has friction: `jaw.xml` has a transmission, in
`jaw_cable.xml` a cable over guides drives it. Every other level of the brake is diagnosed, the
levels between are predicted by the amended model.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import harness
import numpy as np
import pandas as pd
from real_jaw_recordings import SAMPLE_S, JawRecording, read_recordings, split

from cablesense_gap.robot.amending import load_amended, write_amended
from cablesense_gap.robot.model import Robot, load_robot
from cablesense_gap.robot.pipeline import diagnose
from cablesense_gap.robot.prediction import predicted
from cablesense_gap.robot.recording import RobotRecording, read_recording

MODELS = Path(__file__).parents[1] / "config" / "robots"
_NAMES, _TRIAL_GAP_S = ("jaw.xml", "jaw_cable.xml"), 30.0


def main() -> None:
    """Diagnoses half of the reference tool's recordings and predicts the other half."""
    parser = harness.parser(__doc__, "robot_jaw.json")
    parser.add_argument("--data", required=True, help="folder of the jaw's recordings")
    options = parser.parse_args()
    train, parts = split(read_recordings(options.data), None, 0)
    result: dict[str, Any] = {
        **harness.origin("mujoco"),
        "trials": [len(train), len(parts[0].test)],
        **{name: _found(MODELS / name, train, parts[0].test) for name in _NAMES},
    }
    print(json.dumps(result, indent=1, ensure_ascii=False))
    if options.write:
        harness.write_result("robot_jaw.json", result)


def _found(
    path: Path, train: Sequence[JawRecording], test: Sequence[JawRecording]
) -> dict[str, Any]:
    robot = load_robot(path)
    with tempfile.TemporaryDirectory() as folder:
        one, other = (
            _recording(Path(folder) / f"{name}.csv", recordings, robot)
            for name, recordings in (("train", train), ("test", test))
        )
        found = diagnose(one, robot)
        write_amended(Path(folder), robot, found.amended, {})
        amended = load_amended(folder)
        gaps = [predicted(other, *model).gaps[0][2] for model in ((robot, {}), amended)]
    verdict = found.verdict
    return {
        "effects": verdict.effects,
        "probability": round(verdict.probability, 3),
        "ambiguity_group": verdict.ambiguity_group,
        "numbers": {
            name: f"{e.value:.3g} ({e.ci95[0]:.3g} to {e.ci95[1]:.3g}) {e.unit}"
            for name, e in verdict.parameters.items()
        },
        "levels not fitted, drive's torque before and after, mN·m": [
            round(1e3 * gap, 2) for gap in gaps
        ],
        "removed": round(1.0 - gaps[1] / gaps[0], 3),
        "seconds": round(verdict.seconds or 0.0, 1),
    }


def _recording(path: Path, recordings: Sequence[JawRecording], robot: Robot) -> RobotRecording:
    """As a stranger would write it; the drive's torque counts in the direction of its motion."""
    tables = []
    for trial, r in enumerate(recordings):
        time_s = np.arange(len(r.drive_angle_rad)) * SAMPLE_S
        columns = {
            "time_s": time_s + _TRIAL_GAP_S * trial,
            "trial": np.full(len(time_s), trial),
            "position.drive": r.drive_angle_rad,
            "position.jaw": r.jaw_angle_rad,
            "torque.drive": -r.drive_torque_nm,
            "torque.jaw": r.jaw_torque_nm,
        }
        tables.append(pd.DataFrame(columns))
    pd.concat(tables).to_csv(path, index=False)
    return read_recording(path, robot)


if __name__ == "__main__":
    main()
