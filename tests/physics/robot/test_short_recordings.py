"""Recordings of a few seconds: compared up to the frequency that leaves enough rows."""

import pandas as pd
import pytest

from cablesense_gap.robot.model import load_robot
from cablesense_gap.robot.preparation import prepared
from cablesense_gap.robot.recording import read_robot_recording
from cablesense_recording.recording import RecordingError
from tests.helpers.two_link import recorded, write_model


def of_seconds(folder, seconds):
    """The first seconds of a recording, in a robot's folder, and the robot."""
    whole = pd.read_csv(recorded(folder / "whole.csv", trials=1))
    path = folder / "short.csv"
    whole[whole.time_s - whole.time_s[0] < seconds].to_csv(path, index=False)
    robot = load_robot(write_model(folder))
    return read_robot_recording(path, robot), robot


def test_a_short_recording_is_compared_up_to_a_higher_frequency(tmp_path):
    recording, robot = of_seconds(tmp_path, 4.0)
    wide = prepared(recording, robot)
    assert len(wide.compared_trial) >= 30
    with pytest.raises(
        RecordingError, match=r"smoothing to 1.5 Hz, where 30 rows of 2 are needed"
    ):
        prepared(recording, robot, 1.5)


def test_a_recording_that_is_too_short_at_any_frequency_is_refused(tmp_path):
    recording, robot = of_seconds(tmp_path, 1.0)
    with pytest.raises(RecordingError, match="record more trials of several seconds"):
        prepared(recording, robot)
