"""Recordings in chunks: other readers take them, and kill -9 or a cut costs the last chunk."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_msgs_py.qos import LATCHED_QOS, PUBLISHER_QOS
from cablesense_recording.mcap_messages import CHUNK_S, McapMessages, TopicFile
from cablesense_recording.recording import RecordingError
from tests.helpers.checkout import CHECKOUT

S = 1_000_000_000
STATE = "sensor_msgs/msg/JointState"
TEXT = "std_msgs/msg/String"


def written(path, count=2000, step_ns=S // 1000):
    """A file of two topics over some seconds."""
    file = TopicFile(path)
    states = file.add("/cable_tensions", STATE, PUBLISHER_QOS)
    texts = file.add("/robot_description", TEXT, LATCHED_QOS)
    for i in range(count):
        file.write(
            states if i % 10 else texts, 5 * S + i * step_ns, b"\0\1\0\0" + bytes([i % 256]) * 90
        )
    file.close()
    return path


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return written(tmp_path_factory.mktemp("whole") / "whole.mcap")


def test_what_was_written_is_read(whole):
    messages = McapMessages(whole)
    got = list(messages)
    assert messages.cut == ""
    assert len(got) == 2000
    assert [message.log_ns for message in got] == [5 * S + i * S // 1000 for i in range(2000)]
    assert {message.topic: message.kind for message in got} == {
        "/cable_tensions": STATE,
        "/robot_description": TEXT,
    }
    assert [message.data[4] for message in got] == [i % 256 for i in range(2000)]
    assert [path.name for path in whole.parent.iterdir()] == ["whole.mcap"]


def test_rosbags_and_the_mcap_library_read_it_too(whole):
    from mcap.reader import make_reader
    from rosbags.rosbag2 import Reader

    with Reader(whole) as reader:
        assert reader.message_count == 2000
        assert [data[4] for *_, data in reader.messages()] == [i % 256 for i in range(2000)]
        (latched,) = (c for c in reader.connections if c.topic == "/robot_description")
        assert latched.ext.offered_qos_profiles[0].durability.name == "TRANSIENT_LOCAL"
    with whole.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary.statistics.message_count == 2000
        assert summary.statistics.chunk_count == len(summary.chunk_indexes) == 2.0 / CHUNK_S
        assert {index.compression for index in summary.chunk_indexes} == {"zstd"}
        kinds = {schema.name: schema for schema in summary.schemas.values()}
        assert "MSG: std_msgs/Header\nbuiltin_interfaces/Time" in kinds[STATE].data.decode()
        assert sum(1 for _ in reader.iter_messages(starting_at=6 * S)) == 1000
        (metadata,) = reader.iter_metadata()
        assert metadata.name == "rosbag2"
        told = yaml.safe_load(metadata.metadata["serialized_metadata"])
        assert told["message_count"] == 2000
        assert told["relative_file_paths"] == ["whole.mcap"]


@pytest.mark.slow
@given(share=st.floats(0.0, 1.0, exclude_max=True))
@settings(max_examples=20, deadline=None)
def test_a_file_cut_anywhere_gives_all_but_its_last_chunk(whole, share, tmp_path_factory):
    content = whole.read_bytes()
    size = int(share * len(content))
    path = tmp_path_factory.mktemp("cut") / "cut.mcap"
    path.write_bytes(content[:size])
    messages = McapMessages(path)
    if size < 8:
        with pytest.raises(RecordingError, match="no MCAP file"):
            list(messages)
        return
    got = list(messages)
    ends, data_end = _layout(content)
    kept = sum(1 for end in ends if end <= size)
    assert len(got) == 500 * kept
    assert ("breaks off" in messages.cut) == (size < data_end + 9)


def _layout(content):
    """Where chunks end, and where the data do."""
    ends = []
    offset = 8
    while content[offset] != 15:
        length = int.from_bytes(content[offset + 1 : offset + 9], "little")
        if content[offset] == 6:
            ends.append(offset + 9 + length)
        offset += 9 + length
    return ends, offset


@pytest.mark.slow
@given(at=st.floats(0.0, 1.0, exclude_max=True), flip=st.integers(1, 255))
@settings(max_examples=20, deadline=None)
def test_a_damaged_byte_is_refused_or_read_and_never_raises_another_error(
    whole, at, flip, tmp_path_factory
):
    content = bytearray(whole.read_bytes())
    content[int(at * len(content))] ^= flip
    path = tmp_path_factory.mktemp("damaged") / "damaged.mcap"
    path.write_bytes(content)
    try:
        count = len(list(McapMessages(path)))
    except RecordingError as error:
        text = str(error)
    else:
        text = "damaged.mcap"
        assert count <= 2000
    assert "damaged.mcap" in text
    assert "\n" not in text


HEAD = b"\x89MCAP0\r\n"


def record(kind, content, length=None):
    return (
        bytes([kind])
        + (len(content) if length is None else length).to_bytes(8, "little")
        + content
    )


def chunk(packed, packing, unpacked_bytes):
    head = bytes(16) + unpacked_bytes.to_bytes(8, "little") + bytes(4)
    name = len(packing).to_bytes(4, "little") + packing
    return record(6, head + name + len(packed).to_bytes(8, "little") + packed)


def bomb():
    from zstandard import compress

    return compress(bytes(1 << 28))


def zeros():
    """A chunk of one record of a megabyte."""
    from zstandard import compress

    one = record(128, bytes(1 << 20))
    return chunk(compress(one), b"zstd", len(one))


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (HEAD + zeros() * 20, "more than 100 times the bytes of the file"),
        (b"", "no MCAP file"),
        (b"PK" * 100, "no MCAP file"),
        (HEAD + chunk(b"", b"", 1 << 40), "a chunk of 1099511627776 bytes"),
        (HEAD + chunk(bomb(), b"zstd", 1000), "not of the 1000 bytes"),
        (HEAD + chunk(b"junk", b"zstd", 4), "zstd decompress error"),
        (HEAD + chunk(b"junk" * 9, b"lz4", 4), "LZ4F_decompress failed"),
        (HEAD + chunk(b"junk", b"zip", 4), "packed as 'zip'"),
        (HEAD + record(5, bytes(22)), "unknown channel 0"),
        (HEAD + record(5, bytes(3)), "damaged at byte"),
        (HEAD + record(3, b"\1\0\xff\xff\xff\xff"), "damaged at byte 8"),
    ],
    ids=range(11),
)
def test_rubbish_is_refused_unread(content, text, tmp_path):
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    started = time.monotonic()
    with pytest.raises(RecordingError, match=text):
        list(McapMessages(path))
    assert time.monotonic() - started < 5.0


def test_a_length_beyond_the_file_is_a_cut_and_other_places_are_refused(tmp_path):
    path = tmp_path / "a.mcap"
    path.write_bytes(HEAD + record(6, b"", 1 << 62))
    messages = McapMessages(path)
    assert list(messages) == []
    assert "breaks off at byte 8 of 17" in messages.cut
    with pytest.raises(RecordingError, match="no such file"):
        list(McapMessages(tmp_path / "none.mcap"))
    with pytest.raises(RecordingError, match="not a file"):
        list(McapMessages(tmp_path))
    os.mkfifo(tmp_path / "pipe.mcap")
    with pytest.raises(RecordingError, match="not a file"):
        list(McapMessages(tmp_path / "pipe.mcap"))


def test_a_file_that_cannot_be_begun_leaves_the_former_one(tmp_path, monkeypatch):
    def full(self, target):
        raise OSError(28, "No space left on device")

    path = tmp_path / "a.mcap"
    path.write_text("former")
    with pytest.raises(RecordingError, match="exists already"):
        TopicFile(path, force=False)
    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(RecordingError, match="No space left"):
        TopicFile(path)
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [("a.mcap", "former")]


ENDLESS = """
import sys, time
from cablesense_recording.mcap_messages import TopicFile
from cablesense_msgs_py.qos import PUBLISHER_QOS
file = TopicFile(sys.argv[1])
channel = file.add("/cable_tensions", "sensor_msgs/msg/JointState", PUBLISHER_QOS)
number = 0
while True:
    file.write(channel, time.time_ns(), number.to_bytes(8, "little") * 40)
    number += 1
    print(number, flush=True)
    time.sleep(0.0005)
"""


@pytest.mark.slow
def test_a_killed_process_loses_no_more_than_its_last_chunk(tmp_path):
    path = tmp_path / "killed.mcap"
    with subprocess.Popen(
        [sys.executable, "-c", ENDLESS, path], stdout=subprocess.PIPE, text=True, cwd=CHECKOUT
    ) as process:
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(1.3)
        killed_ns = time.time_ns()
        process.send_signal(signal.SIGKILL)
        text = process.stdout.read().split()
    messages = McapMessages(path)
    got = list(messages)
    assert "breaks off" in messages.cut
    assert [int.from_bytes(m.data[:8], "little") for m in got] == list(range(len(got)))
    assert len(got) < int(text[-1])
    assert killed_ns - got[-1].log_ns < (CHUNK_S + 0.3) * 1e9
    assert [path.name for path in tmp_path.iterdir()] == ["killed.mcap"]


@pytest.mark.slow
def test_a_full_disk_is_reported_and_what_was_written_stays(tmp_path):
    path = tmp_path / "full.mcap"
    done = subprocess.run(
        [sys.executable, "-c", ENDLESS, path],
        capture_output=True,
        text=True,
        check=False,
        cwd=CHECKOUT,
        timeout=60,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, 30_000)),
    )
    assert done.returncode == 1
    assert "full.mcap: cannot be written (File too large)" in done.stderr
    messages = McapMessages(path)
    assert len(list(messages)) > 100
    assert "breaks off" in messages.cut
