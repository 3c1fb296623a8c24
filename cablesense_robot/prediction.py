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
from cablesense_robot.inverse import InverseDynamics, prepared
from cablesense_robot.model import Robot
from cablesense_robot.recording import RobotRecording


@dataclass(frozen=True)
class Prediction:
    """Torques of R rows, smoothed with the bandwidth.

    Attributes:
        measured, predicted: (R, J).
        gaps: of each joint with a torque its name, unit, and root mean squares of measured less
            predicted and of measured, where the joint moves.
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
    gaps = []
    for j, (joint, unit) in enumerate(zip(robot.joints, robot.torque_units, strict=True)):
        rows = motion.counts[:, j]
        if rows.any():
            own = motion.torque[rows, j]
            gap, whole = (
                float(np.sqrt((each**2).mean())) for each in (own - torque[rows, j], own)
            )
            gaps.append((joint, unit, gap, whole))
    return Prediction(
        robot.joints, motion.time_s, motion.trial, motion.torque, torque, tuple(gaps),
        motion.bandwidth_hz,
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
