"""Files from elsewhere and of recorders that were killed, of arms and of robots alike."""

from __future__ import annotations

import gzip
import logging

import numpy as np
import pandas as pd
import pytest

from cablesense_gap.robot.model import load_robot
from cablesense_gap.robot.recording import read_robot_recording
from cablesense_recording.csv_file import write_csv
from cablesense_recording.reading import read_recording as read_arm
from cablesense_recording.recording import Recording, RecordingError
from cablesense_sim.arm import open_arm
from tests.helpers.bags import write_joint_states, write_mcap
from tests.helpers.two_link import recorded, write_model

LAB = open_arm("cdsm_lab")
ROWS = 200


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("files")


@pytest.fixture(scope="module")
def robot(folder):
    return load_robot(write_model(folder))


@pytest.fixture(scope="module")
def table(folder):
    columns = pd.read_csv(recorded(folder / "whole.csv", trials=1))[:ROWS]
    return columns.filter(regex="time_s|trial|position|torque")


def of_arm():
    rng = np.random.default_rng(0)
    return Recording(
        name="made",
        time_s=0.2 * np.arange(ROWS),
        trial=np.arange(ROWS) // 20,
        command_rad=np.repeat(rng.uniform(-0.2, 0.2, (ROWS // 4, 8)), 4, axis=0),
        load_segment=np.zeros(ROWS, dtype=np.int64),
        load_n=np.zeros((ROWS, 3)),
        tensions_n=rng.uniform(20.0, 80.0, (ROWS, 12)),
    )


@pytest.fixture(scope="module", params=["arm", "robot"])
def machine(request, folder, robot, table):
    """How a recording is read, the text of its CSV file, and how its bag is written."""
    if request.param == "arm":
        write_csv(folder / "arm.csv", of_arm())
        text = (folder / "arm.csv").read_text()
        return (
            (lambda path: read_arm(path, LAB)),
            text,
            lambda path: write_mcap(path, of_arm(), LAB),
        )
    table.to_csv(folder / "robot.csv", index=False)
    text = (folder / "robot.csv").read_text()
    return (
        (lambda path: read_robot_recording(path, robot)),
        text,
        lambda path: write_joint_states(path, table),
    )


def header_of(text, change):
    first, _, rest = text.partition("\n")
    return f"{change(first)}\n{rest}"


@pytest.mark.parametrize(
    "change",
    [
        lambda text: header_of(text, lambda h: ", ".join(f'"{name}"' for name in h.split(","))),
        lambda text: header_of(text, lambda h: ",".join(f'" {name} "' for name in h.split(","))),
        lambda text: header_of(text, lambda h: " , ".join(h.split(","))),
        lambda text: text.replace(",", " , "),
        lambda text: "\n".join(
            ", ".join(f'"{cell}"' for cell in line.split(",")) for line in text.splitlines()
        ),
        lambda text: "\ufeff" + text,
        lambda text: text.replace("\n", "\r\n"),
    ],
    ids=["quoted", "blanks in quotes", "blanks", "blanks in all", "all quoted", "mark", "Windows"],
)
def test_quotes_blanks_and_ends_of_lines_do_not_matter(tmp_path, machine, change):
    read, text, _ = machine
    (tmp_path / "a.csv").write_bytes(change(text).encode())
    (tmp_path / "a.csv.gz").write_bytes(gzip.compress(change(text).encode()))
    assert len(read(tmp_path / "a.csv")) == ROWS
    assert len(read(tmp_path / "a.csv.gz")) == ROWS


def with_column(text, name, cell):
    first, *rows = text.splitlines()
    return "\n".join([f"{first},{name}", *(f"{row},{cell}" for row in rows)])


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (
            lambda t: with_column(t, "Temperatur [°C]", 21).encode("latin-1"),
            r"line 1 is no UTF-8 text \(byte 0xb0 in .*°C'\); save the file as UTF-8",
        ),
        (
            lambda t: with_column(t, "note", "für").encode("cp1252"),
            "line 2 is no UTF-8 text .byte 0xfc",
        ),
        (
            lambda t: t.encode("utf-16"),
            "is UTF-16 text or no text at all; save it as CSV in UTF-8",
        ),
        (lambda t: t.encode("utf-16-le"), "is UTF-16 text or no text at all"),
        (lambda t: b"PK\x03\x04" + bytes(200), "is UTF-16 text or no text at all"),
        (
            lambda t: f"# logger 3.2\n# 2026-03-01\n{t}".encode(),
            "names its columns in line 3; leave out the lines before it, .* '# logger 3.2'",
        ),
        (lambda t: f"Export\nDate,2026\n\n{t}".encode(), "names its columns in line 4"),
        (lambda t: f"# {t}".encode(), "line 1, which names the columns, begins with #"),
        (lambda t: t.replace(",", ";").encode(), "semicolons separate"),
        (
            lambda t: "\n".join([*t.splitlines()[:9], "# paused", *t.splitlines()[9:]]).encode(),
            "row 9, column time_s: '# paused' is no number",
        ),
        (lambda t: b"", "is empty; its recorder was stopped"),
    ],
    ids=range(11),
)
def test_text_that_cannot_be_read_is_one_line_with_the_cause(tmp_path, machine, content, says):
    read, text, _ = machine
    (tmp_path / "a.csv").write_bytes(content(text))
    with pytest.raises(RecordingError, match=says) as said:
        read(tmp_path / "a.csv")
    assert "\n" not in str(said.value)


@pytest.mark.parametrize("damage", ["breaks off", "is damaged", "is not packed"])
def test_a_packed_file_that_cannot_be_unpacked_is_one_line(tmp_path, machine, damage):
    read, text, _ = machine
    packed = bytearray(gzip.compress(text.encode()))
    if damage == "breaks off":
        packed = packed[: len(packed) // 2]
    elif damage == "is damaged":
        packed[len(packed) // 2] ^= 255
    else:
        packed = bytearray(text.encode())
    (tmp_path / "a.csv.gz").write_bytes(packed)
    with pytest.raises(RecordingError, match="cannot be unpacked") as said:
        read(tmp_path / "a.csv.gz")
    assert "\n" not in str(said.value)


@pytest.mark.slow  # loads the message types
def test_the_folder_of_a_killed_recorder_is_read(tmp_path, machine, caplog):
    read, _, write_bag = machine
    folder = tmp_path / "bag"
    folder.mkdir()
    write_bag(folder / "bag_0.mcap")
    assert len(read(folder)) == ROWS
    for size in (0, 3):
        (folder / "bag_1.mcap").write_bytes(b"\x89MC"[:size])
        with caplog.at_level(logging.WARNING):
            assert len(read(folder)) == ROWS
        assert "bag_1.mcap: breaks off at its begin" in caplog.text
        caplog.clear()
    with pytest.raises(RecordingError, match="has 3 bytes, so it is no MCAP file"):
        read(folder / "bag_1.mcap")


def test_what_is_packed_as_a_whole_or_has_no_index_names_the_remedy(tmp_path, machine):
    read, _, _ = machine
    packed = tmp_path / "a_0.mcap.zstd"
    packed.write_bytes(b"\x28\xb5\x2f\xfd" + bytes(50))
    for path in (packed, tmp_path):
        with pytest.raises(RecordingError, match=r"unpack it first: zstd -d a_0\.mcap\.zstd"):
            read(path)
    (tmp_path / "sqlite").mkdir()
    (tmp_path / "sqlite" / "a_0.db3").write_bytes(b"SQLite format 3\0")
    with pytest.raises(RecordingError, match=r"no metadata\.yaml, .*: ros2 bag reindex"):
        read(tmp_path / "sqlite")


def test_a_name_that_is_no_utf8_is_read_and_shown(tmp_path, machine):
    read, text, _ = machine
    path = tmp_path / b"r\xf6bot.csv".decode("utf-8", "surrogateescape")
    path.write_text(text)
    assert read(path).name == "r\ufffdbot"
