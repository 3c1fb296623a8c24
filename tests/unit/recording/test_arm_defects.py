"""Every defect of an arm's recording, in CSV and in bags: it is named, or it does no harm."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from cablesense_recording.checks import check_recording
from cablesense_recording.csv_file import write_csv
from cablesense_recording.reading import read_recording
from cablesense_recording.recording import Recording, RecordingError
from cablesense_sim.arm import open_arm
from tests.helpers.bags import write_mcap

LAB = open_arm("cdsm_lab")
ROWS = 300


def sound():
    rng = np.random.default_rng(0)
    held = np.repeat(rng.uniform(-0.05, 0.05, (ROWS // 10, 8)), 10, axis=0)
    return Recording(
        name="made",
        time_s=0.2 * np.arange(ROWS),
        trial=np.arange(ROWS) // 30,
        command_rad=held,
        load_segment=np.zeros(ROWS, dtype=np.int64),
        load_n=np.zeros((ROWS, 3)),
        tensions_n=rng.uniform(20.0, 80.0, (ROWS, 12)),
    )


def as_csv(path, recording):
    write_csv(path.with_suffix(".csv"), recording)
    return path.with_suffix(".csv")


def as_bag(path, recording):
    write_mcap(path.with_suffix(".mcap"), recording, LAB, arrives_s=(50.0, 0.2))
    return path.with_suffix(".mcap")


def later(seconds, row=155):
    return lambda r: replace(r, time_s=r.time_s + seconds * (np.arange(len(r)) >= row))


def in_rows(field, rows, value, column=None):
    def change(recording):
        values = getattr(recording, field).copy()
        values[rows if column is None else (rows, column)] = value
        return replace(recording, **{field: values})

    return change


def in_order(order):
    return lambda recording: recording.rows(order(np.arange(len(recording))))


DEFECTS = {
    "clock set back": (later(-3.0), "time_s runs back by 2.8 s in row 156", None),
    "clock set back by a day": (
        later(-86_400.0),
        "time_s runs back by 86399.8 s in row 156",
        None,
    ),
    "row twice": (
        in_order(lambda rows: np.sort(np.append(rows, 99))),
        "time_s stands still in row 101",
        None,
    ),
    "rows in another order": (in_order(lambda rows: rows[::-1]), "time_s runs back", None),
    "one stamp of a later clock": (
        in_rows("time_s", 155, 1.764e9),
        "row 156, of another clock",
        None,
    ),
    "one stamp of an earlier clock": (in_rows("time_s", 155, 1.0), "row 156, of another", None),
    "two clocks by turns": (
        in_rows("time_s", slice(1, None, 2), 5_000.0 + np.arange(150)),
        "time_s",
        None,
    ),
    "paused for a minute": (
        later(60.0),
        None,
        "time_s has a break of 60.2 s within a trial before",
    ),
    "clock set by years": (
        later(1.7e9),
        None,
        r"time_s has a break of 1\.7e\+09 s within a trial",
    ),
    "tension constant": (
        in_rows("tensions_n", slice(None), 42.0, 3),
        None,
        "tension_4_n is 42 N in every row, whatever loads and poses",
    ),
    "tension missing": (
        in_rows("tensions_n", slice(100, 110), np.nan, 3),
        "tension_4_n is empty or not finite in rows 101 to 110",
        None,
    ),
    "a trial that comes back": (
        in_rows("trial", slice(290, None), 0),
        None,
        "trial 0 comes back after another one",
    ),
    "milliseconds": (
        lambda r: replace(r, time_s=1e3 * r.time_s),
        "in s, not in milliseconds",
        None,
    ),
    "microseconds": (
        lambda r: replace(r, time_s=1e6 * r.time_s),
        "in s, not in microseconds",
        None,
    ),
    "none": (lambda r: r, None, None),
}


@pytest.mark.slow  # loads the message types
@pytest.mark.parametrize("write", [as_csv, as_bag])
@pytest.mark.parametrize("defect", DEFECTS)
def test_a_defect_is_named(tmp_path, defect, write):
    change, refused, noted = DEFECTS[defect]
    if refused is not None and write is as_bag:
        refused = re.sub(r"\brow(s?) ([\d to]+\d)", r"message\1 \2 of the readings", refused)
    path = write(tmp_path / "run", change(sound()))
    if refused is not None:
        with pytest.raises(RecordingError, match=refused) as said:
            read_recording(path, LAB)
        assert "\n" not in str(said.value)
        return
    recording = read_recording(path, LAB)
    assert len(recording) == ROWS
    findings = [finding.text for finding in check_recording(recording, LAB)]
    if noted is None:
        assert not findings
    else:
        assert any(re.search(noted, text) for text in findings)


@pytest.mark.slow  # loads the message types
def test_of_two_arms_in_a_bag_that_in_the_name_space_of_a_topic_is_read(tmp_path):
    """The topics of both are in the files of one folder, as `ros2 bag record -a` writes them."""
    folder = tmp_path / "bag"
    folder.mkdir()
    right = replace(sound(), tensions_n=sound().tensions_n + 5.0)
    write_mcap(folder / "bag_0.mcap", sound(), LAB, "left", arrives_s=(50.0, 0.2))
    write_mcap(folder / "bag_1.mcap", right, LAB, "right", arrives_s=(50.1, 0.2))
    with pytest.raises(RecordingError, match=r"choose one, as with --topic /left/") as said:
        read_recording(folder, LAB)
    assert "/right/" in str(said.value)
    recording = read_recording(folder, LAB, ["/right/cable_tensions"])
    np.testing.assert_array_equal(recording.tensions_n, right.tensions_n)
    assert "/right/cable_tensions" in recording.notes[0]
    assert "/left" not in recording.notes[0]
    assert recording.rows(slice(0, 5)).notes == recording.notes
    with pytest.raises(RecordingError, match="misses cable_tensions and joint_commands"):
        read_recording(folder, LAB, ["/none/cable_tensions"])
