"""A recording of an arm or another machine, read by its path, whatever its format, and checked."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cablesense_base import some_of
from cablesense_recording.checks import check_form
from cablesense_recording.column_map import ColumnMap
from cablesense_recording.csv_file import CSV_ENDINGS, read_csv
from cablesense_recording.layout import Described
from cablesense_recording.mapped import read_mapped
from cablesense_recording.mcap_file import is_bag, read_mcap
from cablesense_recording.recording import Recording, RecordingError, refuse_unusable


def read_recording(
    path: str | Path, arm: Described, topics: Sequence[str] = (), columns: ColumnMap | None = None
) -> Recording:
    """Read a recording: a `.csv` or `.csv.gz` file, a `.mcap` file or a rosbag2 folder; check it.

    It is of an arm, or of another machine that is opened. Of a bag with several that is read whose
    `topics` are given. `columns` says what columns of other names and units mean.

    Raises:
        RecordingError: no such file, another format, or what cannot be used.
    """
    path = Path(path)
    if columns is not None:
        if topics:
            raise RecordingError(f"{path}: a map of columns names the topics of a bag itself")
        recording = read_mapped(path, arm, columns)
    elif path.name.lower().endswith(CSV_ENDINGS):
        if topics:
            raise RecordingError(f"{path}: is no bag, so it has no topic {some_of(topics)}")
        recording = read_csv(path, arm)
    elif is_bag(path):
        recording = read_mcap(path, arm, topics)
    else:
        raise RecordingError(
            f"{path}: no recording; give a .csv file, a .mcap file or a rosbag2 folder"
        )
    refuse_unusable(recording, check_form(recording, arm))
    return recording
