"""Real double pendulums of three designs: which effects separate them from their published models.

    python benchmarks/real_double_pendulum.py --data DIR [--write]

`DIR` holds `index.csv` (recording, design) and the runs as gzipped CSV, from the repository
dfki-ric-underactuated-lab/double_pendulum (BSD 3-Clause, Copyright (c) 2022, DFKI RIC
Underactuated Robotics Lab), resampled at 200 Hz. The nominal models are the
`config/robots/double_pendulum_….xml`: published masses, lengths and inertias, no friction. Every
other run of a design is diagnosed; the amended model is judged on the runs between, by the
torques that their motion needs. The makers' software sets both encoders to zero before each run,
wherever friction lets the pendulum hang, so every run has its own zeros, with every model.
"""

from __future__ import annotations

import argparse
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
from cablesense_gap.robot.model import Robot, load_robot
from cablesense_gap.robot.motion import Motion
from cablesense_gap.robot.preparation import prepared
from cablesense_gap.robot.recording import read_recording
from cablesense_gap.robot.report import write_robot_diagnosis
from cablesense_gap.robot.simulator import RobotSimulator
from cablesense_gap.robot.system import RobotDiagnosis, diagnose
from cablesense_gap.simulator import Assignment

MODELS = Path(__file__).parents[1] / "config" / "robots"
DESIGNS = {"A.0": "a0", "C.0": "c0", "C.1": "c1"}
_FRICTION = "joint_friction.joint_{}.torque_n_m"


def main() -> None:
    """Diagnoses one half of each design's runs and judges on the other."""
    parser = harness.parser(__doc__, "real_double_pendulum.json")
    parser.add_argument("--data", type=Path, required=True, help="folder of the runs")
    parser.add_argument("--design", choices=DESIGNS, action="append", help="only this one")
    parser.add_argument("--report", type=Path, help="folder for the report of each design")
    options = parser.parse_args()
    found = {
        design: _of_design(design, options)
        for design in DESIGNS
        if not options.design or design in options.design
    }
    result = {**harness.origin("mujoco"), "designs": found}
    harness.publish("real_double_pendulum.json", result, options)


def _of_design(design: str, options: argparse.Namespace) -> dict[str, Any]:
    index = pd.read_csv(options.data / "index.csv")
    runs = index[index.design == design].recording.tolist()
    robot = load_robot(MODELS / f"double_pendulum_{DESIGNS[design]}.xml")
    with tempfile.TemporaryDirectory() as folder:
        halves = []
        for name, own in (("fitted", runs[::2]), ("judged", runs[1::2])):
            converted(options.data, own, Path(folder) / name)
            halves.append(read_recording(Path(folder) / name, robot))
        fitted, judged = halves
    diagnosis = diagnose(fitted, robot, zeroed=True)
    if options.report is not None:
        write_robot_diagnosis(options.report / DESIGNS[design], diagnosis, {})
    verdict = diagnosis.verdict
    motion = prepared(judged, robot, diagnosis.motion.compared_hz, zeroed=True)
    as_read = replace(motion, zeroed=False)
    return {
        "diagnosed": runs[::2],
        "judged": runs[1::2],
        "effects": verdict.effects,
        "probability": round(verdict.probability, 2),
        "friction_n_m": _friction(diagnosis),
        "parameters": {
            name: [round(estimate.value, 4), *(round(end, 4) for end in estimate.ci95)]
            for name, estimate in verdict.parameters.items()
        },
        "seconds": round(verdict.seconds or 0.0, 1),
        "compared up to, Hz": round(motion.compared_hz, 2),
        "torque error on judged runs, N·m": {
            "torque itself": _sizes(motion, motion.compared(motion.torque)),
            "published model, zeros as they are read": _errors(robot, as_read),
            "amended model, zeros as they are read": _errors(robot, as_read, diagnosis.amended),
            "published model": _errors(robot, motion),
            "amended model": _errors(robot, motion, diagnosis.amended),
        },
    }


def converted(data: Path, runs: Sequence[str], folder: Path) -> None:
    """Runs in the columns that recordings of robots have, a file each."""
    units = {"position": "rad", "torque": "nm"}
    names = {
        f"{what}_{joint}_{unit}": f"{what}.joint_{joint}"
        for what, unit in units.items()
        for joint in (1, 2)
    }
    folder.mkdir()
    for run in runs:
        table = pd.read_csv(data / f"{run}.csv.gz", usecols=["time_s", *names])
        table.rename(columns=names).to_csv(folder / f"{run}.csv.gz", index=False)


def _friction(diagnosis: RobotDiagnosis) -> list[float | None]:
    """Dry friction of both joints, where it is named."""
    found = [diagnosis.verdict.parameters.get(_FRICTION.format(joint)) for joint in (1, 2)]
    return [None if each is None else round(each.value, 3) for each in found]


def _errors(robot: Robot, motion: Motion, effects: Assignment | None = None) -> list[float]:
    """Of a model and effects."""
    simulator = RobotSimulator(robot, motion, effects or {})
    left = simulator.readings - simulator.predict([{}])[0]
    return _sizes(motion, left * simulator.comparison.noise)


def _sizes(motion: Motion, compared: Array) -> list[float]:
    """Root mean square of what is compared, joint by joint, and of both together."""
    square = (compared**2).mean(0) / motion.counts.mean(0)
    return [round(float(np.sqrt(each)), 4) for each in (*square, square.mean())]


if __name__ == "__main__":
    main()
