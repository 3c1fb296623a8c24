"""What a model, nominal or amended, predicts of a recording: torques, or motion."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_gap.recordings.csv_file import write_table
from cablesense_gap.robot.model import Robot
from cablesense_gap.robot.preparation import prepared
from cablesense_gap.robot.recording import RobotRecording
from cablesense_gap.robot.simulator import MotionComparison, RobotSimulator
from cablesense_gap.simulator import Assignment


class Prediction(NamedTuple):
    """Measured and predicted, as compared.

    Attributes:
        predicted: (Q, C) in the comparison's units.
        gaps: of each channel its name, unit, and root mean squares of measured less predicted
            and of measured.
    """

    comparison: MotionComparison
    predicted: Array
    gaps: tuple[tuple[str, str, float, float], ...]


def predicted(
    recording: RobotRecording,
    robot: Robot,
    beside: Assignment,
    bandwidth_hz: float | None = None,
    forward: bool | None = None,
    *,
    zeroed: bool = False,
) -> Prediction:
    """By the model and the effects beside it; arguments as of `diagnose`.

    Raises:
        RecordingError: the recording cannot be compared.
    """
    motion = prepared(recording, robot, bandwidth_hz, forward, zeroed=zeroed)
    simulator = RobotSimulator(robot, motion, beside)
    compared = simulator.comparison
    found = simulator.predict([{}])[0] * compared.noise
    sizes = [np.sqrt((each**2).mean(0)) for each in (compared.readings - found, compared.readings)]
    gaps = zip(compared.names, compared.units, *(s.tolist() for s in sizes), strict=True)
    return Prediction(compared, found, tuple(gaps))


def write_prediction(path: Path, found: Prediction) -> None:
    """Write measured and predicted channels as CSV; the file appears whole or not at all.

    Raises:
        RecordingError: the place cannot be written to.
    """
    compared = found.comparison
    columns = {"time_s": compared.time_s, "trial": compared.trial}
    for c, (name, column) in enumerate(zip(compared.names, compared.columns, strict=True)):
        columns[column] = compared.readings[:, c]
        columns[f"predicted.{name}"] = found.predicted[:, c]
    write_table(path, columns, "%.6g")
