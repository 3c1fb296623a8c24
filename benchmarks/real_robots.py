"""Recordings of real robots, diagnosed from their nominal models of `config/robots`.

    python benchmarks/real_robots.py jaw --data DIR [--write]
    python benchmarks/real_robots.py pendulums --data DIR [--write]

Half of the recordings are diagnosed; the amended model is judged on the others.

`jaw` is that of a da Vinci instrument. Neither nominal model has friction: `jaw.xml` has a
transmission, in `jaw_cable.xml` a cable over guides drives it. Every other level of the brake is
diagnosed. DIR has `index.csv`, one line a recording (recording, folder, frequency_hz,
brake_percent), and a `<recording>.csv.gz` for each, with a row every 10 ms: time_s,
drive_angle_rad, drive_torque_nm, jaw_angle_rad and jaw_torque_nm. `folder` names the tool and how
it is mounted. The tool with the most levels of the brake is used.

`pendulums` are double pendulums of three designs. DIR has `index.csv` (recording, design) and the
runs as gzipped CSV, from the repository dfki-ric-underactuated-lab/double_pendulum (BSD 3-Clause,
Copyright (c) 2022, DFKI RIC Underactuated Robotics Lab), resampled at 200 Hz. The nominal models
have the published masses, lengths and inertias, and no friction. Every other run of a design is
diagnosed; the amended model is judged by the torques that the motion of the others needs. The
makers' software sets both encoders to zero before each run, wherever friction lets the pendulum
hang, so every run has its own zeros, with every model.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

os.environ.setdefault("OMP_NUM_THREADS", "1")

import harness
import numpy as np
import pandas as pd

from cablesense_gap.robot.model import Robot, load_robot
from cablesense_gap.robot.motion import Motion
from cablesense_gap.robot.preparation import prepared
from cablesense_gap.robot.recording import RobotRecording, read_robot_recording
from cablesense_gap.robot.system import RobotSystem, diagnose
from cablesense_gap.simulator import Assignment
from cablesense_gap.verdict import Verdict

MODELS = Path(__file__).parents[1] / "config" / "robots"
_JAWS = ("jaw.xml", "jaw_cable.xml")
_SAMPLE_S = 0.01
_JAW_COLUMNS = {
    "position.drive": ("drive_angle_rad", 1.0),
    "position.jaw": ("jaw_angle_rad", 1.0),
    "torque.drive": ("drive_torque_nm", -1.0),  # in the direction of its motion
    "torque.jaw": ("jaw_torque_nm", 1.0),
}
DESIGNS = {"A.0": "a0", "C.0": "c0", "C.1": "c1"}
_PENDULUM_COLUMNS = {
    f"{what}_{joint}_{unit}": f"{what}.joint_{joint}"
    for what, unit in (("position", "rad"), ("torque", "nm"))
    for joint in (1, 2)
}


def main() -> None:
    """Diagnoses, judges, prints; keeps the figures with `--write`."""
    parser = harness.parser(__doc__, "robot_jaw.json or real_double_pendulum.json")
    parser.add_argument("what", choices=("jaw", "pendulums"), help="of whom the recordings are")
    parser.add_argument("--data", type=Path, required=True, help="folder of the recordings")
    options = parser.parse_args()
    if options.what == "jaw":
        harness.publish("robot_jaw.json", _jaws(options.data), options, "mujoco")
    else:
        designs = {design: _pendulum(design, options.data) for design in DESIGNS}
        harness.publish("real_double_pendulum.json", {"designs": designs}, options, "mujoco")


def _jaws(data: Path) -> dict[str, Any]:
    """The tool with the most levels: its 1st, 3rd … are diagnosed, the others are judged."""
    index = pd.read_csv(data / "index.csv")
    tool = index.groupby("folder", sort=False)["brake_percent"].nunique().idxmax()
    recordings = index[index["folder"] == tool]
    fitted_levels = sorted(recordings["brake_percent"].unique())[::2]
    halves: tuple[list[pd.DataFrame], list[pd.DataFrame]] = [], []
    for row in recordings.itertuples():
        read = pd.read_csv(data / f"{row.recording}.csv.gz")
        columns = {name: sign * read[source] for name, (source, sign) in _JAW_COLUMNS.items()}
        time_s = _SAMPLE_S * np.arange(len(read))
        table = pd.DataFrame({"time_s": time_s, "trial": 0, **columns})
        halves[row.brake_percent not in fitted_levels].append(table)
    figures: dict[str, Any] = {"trials": [len(half) for half in halves]}
    for name in _JAWS:
        robot = load_robot(MODELS / name)
        fitted, unseen = (_recording(half, robot) for half in halves)
        diagnosis = diagnose(fitted, robot)
        motion = prepared(unseen, robot)
        before, after = (
            1e3 * RobotSystem(robot, motion, effects).gaps()[0][2]  # of the drive
            for effects in ({}, diagnosis.amended)
        )
        figures[name] = {
            **_stated(diagnosis.verdict),
            "levels not fitted, drive's torque before and after, mN·m": [
                round(before, 2),
                round(after, 2),
            ],
        }
    return figures


class PendulumRuns(NamedTuple):
    """A design's published model, every other of its runs, and those between."""

    robot: Robot
    diagnosed: RobotRecording
    judged: RobotRecording


def pendulum_runs(design: str, data: Path) -> PendulumRuns:
    """The runs of a design."""
    index = pd.read_csv(data / "index.csv")
    robot = load_robot(MODELS / f"double_pendulum_{DESIGNS[design]}.xml")
    runs = [
        pd.read_csv(data / f"{run}.csv.gz", usecols=["time_s", *_PENDULUM_COLUMNS])
        for run in index[index.design == design].recording
    ]
    tables = [run.rename(columns=_PENDULUM_COLUMNS) for run in runs]
    return PendulumRuns(robot, _recording(tables[::2], robot), _recording(tables[1::2], robot))


def _pendulum(design: str, data: Path) -> dict[str, Any]:
    """Every other run of a design is diagnosed, those between are judged."""
    runs = pendulum_runs(design, data)
    diagnosis = diagnose(runs.diagnosed, runs.robot, zeroed=True)
    compared_hz = diagnosis.system.motion.compared_hz
    motion = prepared(runs.judged, runs.robot, compared_hz, zeroed=True)
    as_read = replace(motion, zeroed=False)
    errors = partial(torque_errors, runs.robot)
    return {
        **_stated(diagnosis.verdict),
        "compared up to, Hz": round(compared_hz, 2),
        "torque error on judged runs, N·m": {
            "published model, zeros as they are read": errors(as_read, {}),
            "amended model, zeros as they are read": errors(as_read, diagnosis.amended),
            "published model": errors(motion, {}),
            "amended model": errors(motion, diagnosis.amended),
        },
    }


def _recording(tables: Sequence[pd.DataFrame], robot: Robot) -> RobotRecording:
    """Tables in the columns that recordings of robots have, read from a file each."""
    with tempfile.TemporaryDirectory() as folder:
        for number, table in enumerate(tables):
            table.to_csv(Path(folder) / f"trial_{number:03d}.csv", index=False)
        return read_robot_recording(Path(folder), robot)


def _stated(verdict: Verdict) -> dict[str, Any]:
    return {
        "effects": verdict.effects,
        "probability": round(verdict.probability, 3),
        "parameters": {
            name: [float(f"{number:.3g}") for number in (each.value, *each.ci95)]
            for name, each in verdict.parameters.items()
        },
    }


def torque_errors(robot: Robot, motion: Motion, effects: Assignment) -> list[float]:
    """Root mean square of a model's torque error, joint by joint, and of both together."""
    gaps = np.array([gap for *_, gap, _ in RobotSystem(robot, motion, effects).gaps()])
    square = gaps**2 / motion.counts.mean(0)  # rows at rest are compared as zeros
    return [round(float(np.sqrt(each)), 4) for each in (*square, square.mean())]


if __name__ == "__main__":
    main()
