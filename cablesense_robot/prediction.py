"""The torques that a model, nominal or amended, predicts for a recording's motion."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_base.files import written_whole
from cablesense_gap.recordings.recording import RecordingError
from cablesense_gap.simulator import Assignment
from cablesense_robot.catalogue import changed
from cablesense_robot.effects.effect import rms
from cablesense_robot.inverse import InverseDynamics
from cablesense_robot.model import Robot
from cablesense_robot.motion import prepared
from cablesense_robot.recording import RobotRecording


@dataclass(frozen=True)
class Prediction:
    """Torques of R rows, compared with a bandwidth; zero where a joint is at rest.

    Attributes:
        measured, predicted: (R, J).
        gaps: of each joint with a torque its name, unit, and root mean squares of measured less
            predicted and of measured.
    """

    joints: tuple[str, ...]
    time_s: Array
    trial: NDArray[np.int64]
    measured: Array
    predicted: Array
    gaps: tuple[tuple[str, str, float, float], ...]
    bandwidth_hz: float


def predicted(
    recording: RobotRecording,
    robot: Robot,
    beside: Assignment,
    bandwidth_hz: float | None = None,
) -> Prediction:
    """By the model and the effects beside it, from the motion alone.

    Raises:
        RecordingError: the recording cannot be compared.
    """
    motion = prepared(recording, robot, bandwidth_hz)
    torque = InverseDynamics(robot, motion).torques(changed(robot, [beside]))
    measured, found = motion.compared(motion.torque), motion.compared(torque)
    gaps = []
    for j, (joint, unit) in enumerate(zip(robot.joints, robot.torque_units, strict=True)):
        if motion.counts[:, j].any():
            left = measured[:, j] - found[:, j]
            gaps.append((joint, unit, rms(left), rms(measured[:, j])))
    return Prediction(
        robot.joints, motion.compared_time_s, motion.compared_trial, measured, found, tuple(gaps),
        motion.compared_hz,
    )  # fmt: skip


def write_prediction(path: Path, found: Prediction) -> None:
    """Write measured and predicted torques as CSV; the file appears whole or not at all.

    Raises:
        RecordingError: the place cannot be written to.
    """
    import pandas as pd

    columns: dict[str, Array | NDArray[np.int64]] = {"time_s": found.time_s, "trial": found.trial}
    for j, joint in enumerate(found.joints):
        columns[f"torque.{joint}"] = found.measured[:, j]
        columns[f"predicted.{joint}"] = found.predicted[:, j]
    with written_whole(path, RecordingError) as beside:
        pd.DataFrame(columns).to_csv(beside, index=False, float_format="%.6g")
