"""Recordings as CSV: what is written is read back, and what is no recording is refused."""

from __future__ import annotations

import gzip
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_recording import csv_file
from cablesense_recording.csv_file import all_columns, read_csv, write_csv
from cablesense_recording.recording import Recording, RecordingError
from cablesense_sim.arm import open_arm

LAB = open_arm("cdsm_lab")
NINE = open_arm("cdsm_table2")


def recording(arm=LAB, rows=5, seed=0):
    rng = np.random.default_rng(seed)
    segment = np.arange(rows) % (arm.segment_count + 1)
    return Recording(
        name="made",
        time_s=0.2 * np.arange(rows),
        trial=np.arange(rows) // 2,
        command_rad=rng.uniform(-0.2, 0.2, (rows, arm.joint_count)),
        load_segment=segment,
        load_n=rng.uniform(-60, 60, (rows, 3)) * (segment > 0)[:, None],
        tensions_n=rng.uniform(0, 200, (rows, arm.cable_count)),
    )


def with_places(sent):
    """At three places of the loaded segments; every fourth is left to the arm file."""
    at_m = np.array([0.03, 0.065, 0.11, np.nan])[np.arange(len(sent)) % 4]
    return replace(sent, load_at_m=np.where(sent.load_segment > 0, at_m, np.nan))


def lines_of(path):
    return path.read_text(encoding="utf-8").splitlines()


def written(tmp_path, change=lambda lines: lines):
    path = tmp_path / "made.csv"
    write_csv(path, recording())
    path.write_text("\n".join(change(lines_of(path))) + "\n", encoding="utf-8")
    return path


def in_cell(row, column, value):
    def change(lines):
        index = lines[0].split(",").index(column)
        cells = lines[row].split(",")
        cells[index] = value
        return [*lines[:row], ",".join(cells), *lines[row + 1 :]]

    return change


@pytest.mark.parametrize("arm", [LAB, NINE], ids=lambda arm: arm.name)
@given(rows=st.integers(1, 40), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None)
def test_what_is_written_is_read_back(arm, rows, seed, tmp_path_factory):
    path = tmp_path_factory.mktemp("csv") / "made.csv"
    sent = recording(arm, rows, seed)
    write_csv(path, sent)
    got = read_csv(path, arm)
    assert got.name == "made"
    np.testing.assert_array_equal(got.trial, sent.trial)
    np.testing.assert_array_equal(got.load_segment, sent.load_segment)
    np.testing.assert_allclose(got.time_s, sent.time_s, atol=0.51e-6)
    np.testing.assert_allclose(got.command_rad, sent.command_rad, atol=0.51e-6)
    np.testing.assert_allclose(got.load_n, sent.load_n, atol=0.51e-6)
    np.testing.assert_allclose(got.tensions_n, sent.tensions_n, atol=0.51e-6)
    assert got.load_at_m is None
    assert [p.name for p in path.parent.iterdir()] == ["made.csv"]


def test_places_of_loads_are_read_back_and_an_empty_column_is_none(tmp_path):
    sent = with_places(recording(rows=12))
    write_csv(tmp_path / "a.csv", sent)
    np.testing.assert_array_equal(read_csv(tmp_path / "a.csv", LAB).load_at_m, sent.load_at_m)
    write_csv(tmp_path / "b.csv", replace(sent, load_at_m=np.full(12, np.nan)))
    got = read_csv(tmp_path / "b.csv", LAB)
    assert "load_at_m" in lines_of(tmp_path / "b.csv")[0]
    assert got.load_at_m is None


def test_columns_are_found_by_name_and_unknown_ones_left_out(tmp_path):
    def reversed_with_note(lines):
        turned = [",".join(line.split(",")[::-1]) for line in lines]
        return [turned[0] + ",note", *(line + ",hung by hand" for line in turned[1:])]

    got = read_csv(written(tmp_path, reversed_with_note), LAB)
    np.testing.assert_allclose(got.tensions_n, recording().tensions_n, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda lines: [line.rpartition(",")[0] for line in lines], "misses tension_12_n"),
        (
            lambda lines: [lines[0] + ",time_s", *(f"{x},1" for x in lines[1:])],
            "time_s appears twice",
        ),
        (lambda lines: [lines[0] + ",tension_13_n", *(f"{x},1" for x in lines[1:])], "has tens"),
        (lambda lines: [*lines[:3], lines[3] + ",7", *lines[4:]], "as many cells as the header"),
        (lambda lines: [lines[0], *(f"{x},7" for x in lines[1:])], "as many cells as the header"),
        (in_cell(2, "tension_3_n", "5O.1"), "row 2, column tension_3_n: '5O.1' is no number"),
        (in_cell(3, "time_s", "1e300"), "row 3, column time_s: '1e\\+300' is beyond 1e\\+10 s"),
        (in_cell(2, "trial", "9" * 400), "column trial: inf is no whole number"),
        (in_cell(4, "trial", "1.5"), "row 4, column trial: 1.5 is no whole number"),
        (in_cell(1, "load_segment", ""), "row 1, column load_segment: nan is no whole number"),
        (
            lambda lines: [lines[0] + ",load_at_m", *(f"{x},middle" for x in lines[1:])],
            "row 1, column load_at_m: 'middle' is no number",
        ),
        (lambda lines: [], "cannot be read as CSV text"),
    ],
)
def test_a_broken_file_is_one_line_that_says_where(change, said, tmp_path):
    with pytest.raises(RecordingError, match=said) as caught:
        read_csv(written(tmp_path, change), LAB)
    assert "\n" not in str(caught.value)
    assert "made.csv" in str(caught.value)


def test_a_recording_of_another_arm_is_refused(tmp_path):
    write_csv(tmp_path / "nine.csv", recording(NINE))
    with pytest.raises(RecordingError, match=r"misses q7_cmd_rad, q8_cmd_rad, tension_10_n"):
        read_csv(tmp_path / "nine.csv", LAB)
    write_csv(tmp_path / "twelve.csv", recording(LAB))
    with pytest.raises(RecordingError, match=r"has q7_cmd_rad, q8_cmd_rad, tension_10_n"):
        read_csv(tmp_path / "twelve.csv", NINE)


def test_no_file_a_folder_bytes_and_too_large_a_file_are_refused(tmp_path, monkeypatch):
    for path in (tmp_path / "none.csv", tmp_path):
        with pytest.raises(RecordingError, match="no such file"):
            read_csv(path, LAB)
    (tmp_path / "bytes.csv").write_bytes(bytes(range(256)))
    with pytest.raises(RecordingError, match="is UTF-16 text or no text at all"):
        read_csv(tmp_path / "bytes.csv", LAB)
    monkeypatch.setattr(csv_file, "MAX_FILE_BYTES", 1000)
    with pytest.raises(RecordingError, match="at most"):
        read_csv(written(tmp_path), LAB)


def test_a_packed_file_is_read_and_too_many_numbers_are_refused(tmp_path, monkeypatch):
    path = tmp_path / "made.csv.gz"
    path.write_bytes(gzip.compress(written(tmp_path).read_bytes()))
    assert read_csv(path, LAB).name == "made"
    monkeypatch.setattr(csv_file, "MAX_NUMBERS", 4 * 26)
    with pytest.raises(RecordingError, match="more than 104 numbers"):
        read_csv(path, LAB)


@pytest.mark.parametrize(("mark", "named"), [(";", "semicolons"), ("\t", "tabs")])
def test_other_marks_between_columns_are_named(tmp_path, mark, named):
    path = tmp_path / "semicolons.csv"
    path.write_text(mark.join(all_columns(8, 12)) + "\n")
    with pytest.raises(RecordingError, match=f"{named} separate its columns"):
        read_csv(path, open_arm("cdsm_lab"))
