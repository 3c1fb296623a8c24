"""A recording by its path, whatever its format."""

from __future__ import annotations

from pathlib import Path

from cablesense_gap.recordings.csv_file import read_csv
from cablesense_gap.recordings.mcap_file import is_bag, read_mcap
from cablesense_gap.recordings.recording import Recording
from cablesense_gap.recordings.recording_error import RecordingError
from cablesense_sim.arm import Arm


def read_recording(path: str | Path, arm: Arm) -> Recording:
    """Read a recording: a `.csv` file, a `.mcap` file or a rosbag2 folder.

    Raises:
        RecordingError: no such file, another format, or what cannot be used.
    """
    path = Path(path)
    if path.suffix.lower() == ".csv":
        return read_csv(path, arm)
    if is_bag(path):
        return read_mcap(path, arm)
    raise RecordingError(
        f"{path}: no recording; give a .csv file, a .mcap file or a rosbag2 folder"
    )
