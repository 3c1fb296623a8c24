"""The recorded jaw of a da Vinci instrument, diagnosed as any robot: MJCF files and recordings.

    python benchmarks/real_jaw.py --data DIR [--write]

Neither nominal model of `config/robots` has friction: `jaw.xml` has a transmission, in
`jaw_cable.xml` a cable over guides drives it. Every other level of the brake is diagnosed. The
amended model predicts the levels between them.

DIR has `index.csv`, one line a recording (recording, folder, frequency_hz, brake_percent), and a
`<recording>.csv.gz` for each, with a row every 10 ms: time_s, drive_angle_rad, drive_torque_nm,
jaw_angle_rad and jaw_torque_nm. `folder` names the tool and how it is mounted. The tool with the
most levels of the brake is used.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import harness
import numpy as np
import pandas as pd

from cablesense_gap.robot.amending import load_amended, write_amended
from cablesense_gap.robot.model import Robot, load_robot
from cablesense_gap.robot.prediction import predicted
from cablesense_gap.robot.recording import RobotRecording, read_recording
from cablesense_gap.robot.system import diagnose

MODELS = Path(__file__).parents[1] / "config" / "robots"
COLUMNS = {
    "position.drive": ("drive_angle_rad", 1.0),
    "position.jaw": ("jaw_angle_rad", 1.0),
    "torque.drive": ("drive_torque_nm", -1.0),  # in the direction of its motion
    "torque.jaw": ("jaw_torque_nm", 1.0),
}
_NAMES, _SAMPLE_S, _TRIAL_GAP_S = ("jaw.xml", "jaw_cable.xml"), 0.01, 30.0


def main() -> None:
    """Diagnoses half of the reference tool's recordings and predicts the other half."""
    parser = harness.parser(__doc__, "results/robot_jaw.json")
    parser.add_argument("--data", type=Path, required=True, help="folder of the recordings")
    options = parser.parse_args()
    fitted, unseen = halves(options.data)
    result: dict[str, Any] = {
        **harness.origin("mujoco"),
        "trials": [len(fitted), len(unseen)],
        **{name: _found(MODELS / name, fitted, unseen) for name in _NAMES},
    }
    harness.publish("robot_jaw.json", result, options)


def halves(folder: Path) -> tuple[list[pd.DataFrame], list[pd.DataFrame]]:
    """Recordings of the reference tool at its 1st, 3rd … level of the brake, and at the others."""
    index = pd.read_csv(folder / "index.csv")
    tool = index.groupby("folder", sort=False)["brake_percent"].nunique().idxmax()
    own = index[index["folder"] == tool]
    fitted_levels = sorted(own["brake_percent"].unique())[::2]
    fitted: list[pd.DataFrame] = []
    unseen: list[pd.DataFrame] = []
    for row in own.itertuples():
        half = fitted if row.brake_percent in fitted_levels else unseen
        half.append(pd.read_csv(folder / f"{row.recording}.csv.gz"))
    return fitted, unseen


def _found(path: Path, fitted: list[pd.DataFrame], unseen: list[pd.DataFrame]) -> dict[str, Any]:
    robot = load_robot(path)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        one = _recording(folder / "fitted.csv", fitted, robot)
        other = _recording(folder / "unseen.csv", unseen, robot)
        found = diagnose(one, robot)
        write_amended(folder, robot, found.amended, {})
        gaps = [
            predicted(other, *model).gaps[0][2] for model in ((robot, {}), load_amended(folder))
        ]
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


def _recording(path: Path, trials: list[pd.DataFrame], robot: Robot) -> RobotRecording:
    tables = []
    for trial, table in enumerate(trials):
        time_s = _TRIAL_GAP_S * trial + _SAMPLE_S * np.arange(len(table))
        columns = {name: sign * table[source] for name, (source, sign) in COLUMNS.items()}
        tables.append(pd.DataFrame({"time_s": time_s, "trial": trial, **columns}))
    pd.concat(tables).to_csv(path, index=False)
    return read_recording(path, robot)


if __name__ == "__main__":
    main()
