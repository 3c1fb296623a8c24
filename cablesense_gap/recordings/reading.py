"""A recording by its path, whatever its format."""

from __future__ import annotations

from pathlib import Path

from cablesense_gap.recordings.checks import check_form
from cablesense_gap.recordings.csv_file import read_csv
from cablesense_gap.recordings.mcap_file import is_bag, read_mcap
from cablesense_gap.recordings.recording import Recording
from cablesense_gap.recordings.recording_error import RecordingError
from cablesense_sim.arm import Arm


def read_recording(path: str | Path, arm: Arm) -> Recording:
    """Read a recording: a `.csv` file, a `.mcap` file or a rosbag2 folder; check its form.

    Raises:
        RecordingError: no such file, another format, or what cannot be used.
    """
    path = Path(path)
    if path.suffix.lower() == ".csv":
        recording = read_csv(path, arm)
    elif is_bag(path):
        recording = read_mcap(path, arm)
    else:
        raise RecordingError(
            f"{path}: no recording; give a .csv file, a .mcap file or a rosbag2 folder"
        )
    check_form(recording, arm).raise_if_unusable()
    return recording
