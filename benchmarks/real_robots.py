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
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import harness
import numpy as np
import pandas as pd

from cablesense_base import Array
from cablesense_gap.robot.amending import load_amended, write_amended
from cablesense_gap.robot.model import Robot, load_robot
from cablesense_gap.robot.motion import Motion
from cablesense_gap.robot.preparation import prepared
from cablesense_gap.robot.recording import RobotRecording, read_recording
from cablesense_gap.robot.system import RobotSystem, diagnose
from cablesense_gap.simulator import Assignment

MODELS = Path(__file__).parents[1] / "config" / "robots"
_JAWS, _SAMPLE_S, _TRIAL_GAP_S = ("jaw.xml", "jaw_cable.xml"), 0.01, 30.0
_JAW_COLUMNS = {
    "position.drive": ("drive_angle_rad", 1.0),
    "position.jaw": ("jaw_angle_rad", 1.0),
    "torque.drive": ("drive_torque_nm", -1.0),  # in the direction of its motion
    "torque.jaw": ("jaw_torque_nm", 1.0),
}
_DESIGNS = {"A.0": "a0", "C.0": "c0", "C.1": "c1"}
_PENDULUM_COLUMNS = {
    f"{what}_{joint}_{unit}": f"{what}.joint_{joint}"
    for what, unit in (("position", "rad"), ("torque", "nm"))
    for joint in (1, 2)
}
_FRICTION = "joint_friction.joint_{}.torque_n_m"


def main() -> None:
    """Diagnoses, judges, prints; keeps the figures with `--write`."""
    parser = harness.parser(__doc__, "robot_jaw.json or real_double_pendulum.json")
    parser.add_argument("what", choices=("jaw", "pendulums"), help="of whom the recordings are")
    parser.add_argument("--data", type=Path, required=True, help="folder of the recordings")
    options = parser.parse_args()
    if options.what == "jaw":
        fitted, unseen = _jaw_halves(options.data)
        found = {name: _jaw(MODELS / name, fitted, unseen) for name in _JAWS}
        trials = {"trials": [len(fitted), len(unseen)]}
        harness.publish("robot_jaw.json", trials | found, options, "mujoco")
    else:
        designs = {each: _pendulum(each, options.data) for each in _DESIGNS}
        harness.publish("real_double_pendulum.json", {"designs": designs}, options, "mujoco")


def _jaw_halves(data: Path) -> tuple[list[pd.DataFrame], list[pd.DataFrame]]:
    """Recordings of the reference tool at its 1st, 3rd … level of the brake, and at the others."""
    index = pd.read_csv(data / "index.csv")
    tool = index.groupby("folder", sort=False)["brake_percent"].nunique().idxmax()
    own = index[index["folder"] == tool]
    fitted_levels = sorted(own["brake_percent"].unique())[::2]
    halves: tuple[list[pd.DataFrame], list[pd.DataFrame]] = [], []
    for row in own.itertuples():
        table = pd.read_csv(data / f"{row.recording}.csv.gz")
        halves[row.brake_percent not in fitted_levels].append(table)
    return halves


def _jaw(path: Path, fitted: list[pd.DataFrame], unseen: list[pd.DataFrame]) -> dict[str, Any]:
    robot = load_robot(path)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        one = _jaw_recording(folder / "fitted.csv", fitted, robot)
        other = _jaw_recording(folder / "unseen.csv", unseen, robot)
        found = diagnose(one, robot)
        write_amended(folder, robot, found.amended, {})
        gaps = [
            RobotSystem(nominal, prepared(other, nominal), beside).gaps()[0][2]
            for nominal, beside in ((robot, {}), load_amended(folder))
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


def _jaw_recording(path: Path, trials: list[pd.DataFrame], robot: Robot) -> RobotRecording:
    tables = []
    for trial, table in enumerate(trials):
        time_s = _TRIAL_GAP_S * trial + _SAMPLE_S * np.arange(len(table))
        columns = {name: sign * table[source] for name, (source, sign) in _JAW_COLUMNS.items()}
        tables.append(pd.DataFrame({"time_s": time_s, "trial": trial, **columns}))
    pd.concat(tables).to_csv(path, index=False)
    return read_recording(path, robot)


def _pendulum(design: str, data: Path) -> dict[str, Any]:
    index = pd.read_csv(data / "index.csv")
    runs = index[index.design == design].recording.tolist()
    robot = load_robot(MODELS / f"double_pendulum_{_DESIGNS[design]}.xml")
    fitted, judged = (_pendulum_recording(data, own, robot) for own in (runs[::2], runs[1::2]))
    diagnosis = diagnose(fitted, robot, zeroed=True)
    verdict, amended = diagnosis.verdict, diagnosis.amended
    motion = prepared(judged, robot, diagnosis.system.motion.compared_hz, zeroed=True)
    as_read = replace(motion, zeroed=False)
    friction = [verdict.parameters.get(_FRICTION.format(joint)) for joint in (1, 2)]
    return {
        "diagnosed": runs[::2],
        "judged": runs[1::2],
        "effects": verdict.effects,
        "probability": round(verdict.probability, 2),
        "friction_n_m": [None if each is None else round(each.value, 3) for each in friction],
        "parameters": {
            name: [round(estimate.value, 4), *(round(end, 4) for end in estimate.ci95)]
            for name, estimate in verdict.parameters.items()
        },
        "seconds": round(verdict.seconds or 0.0, 1),
        "compared up to, Hz": round(motion.compared_hz, 2),
        "torque error on judged runs, N·m": {
            "torque itself": _sizes(motion, motion.compared(motion.torque)),
            "published model, zeros as they are read": _errors(robot, as_read, {}),
            "amended model, zeros as they are read": _errors(robot, as_read, amended),
            "published model": _errors(robot, motion, {}),
            "amended model": _errors(robot, motion, amended),
        },
    }


def _pendulum_recording(data: Path, runs: Sequence[str], robot: Robot) -> RobotRecording:
    """Runs in the columns that recordings of robots have, a file each."""
    with tempfile.TemporaryDirectory() as folder:
        for run in runs:
            table = pd.read_csv(data / f"{run}.csv.gz", usecols=["time_s", *_PENDULUM_COLUMNS])
            renamed = table.rename(columns=_PENDULUM_COLUMNS)
            renamed.to_csv(Path(folder) / f"{run}.csv.gz", index=False)
        return read_recording(Path(folder), robot)


def _errors(robot: Robot, motion: Motion, effects: Assignment) -> list[float]:
    """Of a model and effects."""
    simulator = RobotSystem(robot, motion, effects)
    left = simulator.readings - simulator.predict([{}])[0]
    return _sizes(motion, left * simulator.comparison.noise)


def _sizes(motion: Motion, compared: Array) -> list[float]:
    """Root mean square of the comparison, joint by joint, and of both together."""
    square = (compared**2).mean(0) / motion.counts.mean(0)
    return [round(float(np.sqrt(each)), 4) for each in (*square, square.mean())]


if __name__ == "__main__":
    main()
