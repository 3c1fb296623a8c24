"""Diagnoses the gap of your own robot: an MJCF and a recording of it.

    python -m examples.own_robot                             # a planted case: friction of joint_2
    python -m examples.own_robot robot.xml recording.csv     # yours

docs/robot.md describes the recording; `cablesense gap protocol --model robot.xml` what to record.
"""

from __future__ import annotations

import sys
from pathlib import Path

import mujoco
import numpy as np
import pandas as pd

from cablesense_base.installation import config_path
from cablesense_gap.report.text import headline, size_lines
from cablesense_gap.robot.model import load_robot
from cablesense_gap.robot.recording import read_robot_recording
from cablesense_gap.robot.system import diagnose

TRIALS = 6
TRIAL_S = 4.0
PERIOD_S = 0.01
FRICTION_N_M = np.array([0.0, 0.2])
ENCODER_STEP_RAD = 1e-4
NOISE_N_M = 0.01


def record(model_file: Path, recording: Path) -> None:
    """Write what a drive with dry friction on its second joint would record of slow sines."""
    model = mujoco.MjModel.from_xml_path(str(model_file))
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    rows = []
    for trial in range(TRIALS):
        size = rng.uniform(0.3, 0.8, 2)
        pace = 2.0 * np.pi * rng.uniform(0.3, 0.9, 2)
        for time_s in np.arange(0.0, TRIAL_S, PERIOD_S):
            sine = size * np.sin(pace * time_s)
            cosine = size * np.cos(pace * time_s)
            data.qpos = sine
            data.qvel = pace * cosine
            data.qacc = -(pace**2) * sine
            mujoco.mj_inverse(model, data)
            torque = data.qfrc_inverse + FRICTION_N_M * np.sign(data.qvel)
            torque += rng.normal(0.0, NOISE_N_M, 2)
            position = np.round(sine / ENCODER_STEP_RAD) * ENCODER_STEP_RAD
            rows.append([trial * TRIAL_S + time_s, trial, *position, *torque])
    joints = [model.joint(number).name for number in range(2)]
    measured = [f"{kind}.{joint}" for kind in ("position", "torque") for joint in joints]
    pd.DataFrame(rows, columns=["time_s", "trial", *measured]).to_csv(recording, index=False)


def main(model_file: Path, recording: Path) -> None:
    """Print which effects explain the gap, and how large they are."""
    robot = load_robot(model_file)
    verdict = diagnose(read_robot_recording(recording, robot), robot).verdict
    print(headline(verdict), *size_lines(verdict), sep="\n")


def planted(folder: Path = Path("out/own_robot")) -> tuple[Path, Path]:
    """The model file and the recording of the planted case."""
    folder.mkdir(parents=True, exist_ok=True)
    model_file = config_path("robots/two_links.xml")
    recording = folder / "recording.csv"
    record(model_file, recording)
    return model_file, recording


if __name__ == "__main__":
    main(*(map(Path, sys.argv[1:3]) if len(sys.argv) > 2 else planted()))
