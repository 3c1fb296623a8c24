"""Recordings as rosbag2 MCAP: written, read back, and refused with a reason."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_msgs_py import topics
from cablesense_recording import mcap_file
from cablesense_recording.column_map import ColumnMap
from cablesense_recording.mcap_file import read_mcap
from cablesense_recording.reading import read_recording
from cablesense_recording.recording import Recording, RecordingError
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.kinematics import chain as chain_of
from tests.helpers.bags import Bag, write_mcap

LAB = open_arm("cdsm_lab")
NINE = open_arm("cdsm_table2")
S = 1_000_000_000


def recording(arm=LAB, rows=30, seed=0):
    rng = np.random.default_rng(seed)
    segment = np.repeat(rng.integers(0, arm.segment_count + 1, rows), 3)[:rows]
    held = np.repeat(rng.uniform(-0.2, 0.2, (rows, arm.joint_count)), 4, axis=0)[:rows]
    return Recording(
        name="made",
        time_s=0.2 * np.arange(rows),
        trial=np.arange(rows) // 7 + 3,
        command_rad=held,
        load_segment=segment,
        load_n=rng.uniform(-60, 60, (rows, 3)) * (segment > 0)[:, None],
        tensions_n=rng.uniform(0, 200, (rows, arm.cable_count)),
    )


STATES = {
    "tensions": (topics.CABLE_TENSIONS, "effort"),
    "command": (topics.JOINT_COMMANDS, "position"),
    "offsets": (topics.CABLE_OFFSETS, "position"),
}


def put(writer, what, log_ns, *arguments):
    if what in STATES:
        (topic, field) = STATES[what]
        (stamp_ns, names, values) = arguments
        writer.joint_state(topic, log_ns, stamp_ns, names, **{field: values})
    else:
        getattr(writer, what)(log_ns, *arguments)


def bag(path, *calls, rest_s=1.0):
    """A bag of some calls of `Bag`, one a tenth of a second."""
    with Bag(path) as writer:
        for i, (method, *arguments) in enumerate(calls, start=1):
            stamp_ns = round((rest_s + 0.1 * i) * S)
            stamps = (stamp_ns,) if method == "trial" else (stamp_ns, stamp_ns)
            put(writer, method, *stamps, *arguments)
    return path


COMMAND = ("command", LAB.joint_names, [0.01 * i for i in range(8)])
TENSIONS = ("tensions", LAB.cable_names, [50.0 + i for i in range(12)])


@pytest.mark.slow
@pytest.mark.parametrize("arm", [LAB, NINE], ids=lambda arm: arm.name)
@given(rows=st.integers(1, 60), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=10, deadline=None)
def test_what_is_written_is_read_back(arm, rows, seed, tmp_path_factory):
    path = tmp_path_factory.mktemp("bag") / "made.mcap"
    sent = recording(arm, rows, seed)
    write_mcap(path, sent, arm)
    got = read_recording(path, arm)
    assert got.name == "made"
    np.testing.assert_allclose(got.time_s, sent.time_s, atol=1e-8)
    for field in ("trial", "command_rad", "load_segment", "load_n", "tensions_n"):
        np.testing.assert_array_equal(getattr(got, field), getattr(sent, field), field)
    assert [p.name for p in path.parent.iterdir()] == ["made.mcap"]


def test_command_and_load_hold_until_the_next_and_rows_before_a_command_are_left_out(tmp_path):
    path = bag(
        tmp_path / "a.mcap",
        TENSIONS,
        COMMAND,
        TENSIONS,
        ("load", "left_segment_2", (1.0, 2.0, 3.0)),
        TENSIONS,
        TENSIONS,
        ("load", "left_segment_2", (0.0, 0.0, 0.0)),
        TENSIONS,
    )
    got = read_mcap(path, LAB)
    assert got.load_segment.tolist() == [0, 2, 2, 0]
    assert got.load_n[1].tolist() == [1.0, 2.0, 3.0]
    np.testing.assert_allclose(got.time_s, [0.0, 0.2, 0.3, 0.5])
    assert got.trial.tolist() == [0, 1, 1, 1]


def test_a_load_at_another_place_begins_a_trial(tmp_path):
    """Near the contact point it is taken for one there, as a loaded arm is not where commanded."""
    force = np.array([0.0, 5.0, 3.0])
    chain = chain_of(mechanism_of(LAB), np.array(COMMAND[2]))

    def put_at(place_m):
        point_m = chain.joint_m[1] + place_m * chain.rotation[1, :, 0]
        return "load", "base_link", force, np.cross(point_m, force)

    path = bag(
        tmp_path / "a.mcap",
        COMMAND,
        TENSIONS,
        put_at(0.04),
        TENSIONS,
        TENSIONS,
        put_at(0.11),
        TENSIONS,
        put_at(0.07),
        TENSIONS,
        ("load", "segment_2", 0.0 * force),
        TENSIONS,
    )
    got = read_mcap(path, LAB)
    np.testing.assert_array_equal(got.load_at_m, [np.nan, 0.04, 0.04, 0.11, np.nan, np.nan])
    assert got.trial.tolist() == [0, 1, 1, 2, 3, 3]


WITH_OFFSETS = (
    TENSIONS,
    ("offsets", LAB.cable_names, [1e-5] * 12),
    TENSIONS,
    ("offsets", LAB.cable_names, [0.0] * 12),
    TENSIONS,
)
"""Three readings, the second of which comes while the cables are longer than commanded."""


def test_rows_with_offset_cables_are_left_out(tmp_path):
    path = bag(tmp_path / "a.mcap", COMMAND, *WITH_OFFSETS)
    np.testing.assert_allclose(read_mcap(path, LAB).time_s, [0.0, 0.4])


def test_without_stamps_the_time_of_arrival_counts(tmp_path):
    with Bag(tmp_path / "a.mcap") as writer:
        put(writer, "command", S, 0, *COMMAND[1:])
        for i in range(3):
            put(writer, "tensions", 2 * S + i * S // 4, 0, *TENSIONS[1:])
    np.testing.assert_allclose(read_mcap(tmp_path / "a.mcap", LAB).time_s, [0.0, 0.25, 0.5])


@pytest.mark.parametrize("columns", [None, ColumnMap()], ids=["contract", "map"])
def test_a_fault_is_where_the_message_is_that_has_it(tmp_path, columns):
    """The first three readings come before any command, and are no rows."""
    path = tmp_path / "a.mcap"
    with Bag(path) as writer:
        for i in range(40):
            at_ns = S + i * S // 10
            if i == 3:
                put(writer, "command", at_ns, at_ns, *COMMAND[1:])
            stamp_ns = at_ns - 3 * S // 2 if i >= 30 else at_ns
            put(writer, "tensions", at_ns, stamp_ns, *TENSIONS[1:])
    with pytest.raises(RecordingError, match="in message 31 of the readings") as caught:
        read_recording(path, LAB, columns=columns)
    assert "runs back by 1.4 s" in str(caught.value)
    assert "sort" not in str(caught.value)
    assert "record again" in str(caught.value)


def test_messages_keep_their_numbers_where_rows_are_left_out(tmp_path):
    path = bag(tmp_path / "a.mcap", TENSIONS, COMMAND, *WITH_OFFSETS)
    recording = read_mcap(path, LAB)
    assert recording.message.tolist() == [2, 4]
    assert recording.rows(slice(1, None)).where(np.array([True])) == "message 4 of the readings"


def test_a_folder_with_metadata_is_read_too(tmp_path):
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    path = bag(tmp_path / "a.mcap", COMMAND, TENSIONS, TENSIONS)
    folder = tmp_path / "folder"
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as out:
        for raw, message in mcap_file.decoded(path, lambda raw: True):
            known = {c.topic: c for c in out.connections}
            name = f"/lab{raw.topic}"
            connection = known.get(name) or out.add_connection(name, raw.kind, typestore=store)
            # publishers leave bytes behind a message's end
            content = bytes(store.serialize_cdr(message, raw.kind)) + bytes(9)
            out.write(connection, raw.log_ns, content)
    a = read_recording(folder, LAB)
    b = read_recording(path, LAB)
    np.testing.assert_array_equal(a.tensions_n, b.tensions_n)
    assert a.name == "folder"


@pytest.mark.parametrize(
    ("calls", "said"),
    [
        ([TENSIONS], "misses joint_commands, and has /cable_tensions"),
        ([COMMAND], "misses cable_tensions"),
        ([TENSIONS, COMMAND], "no message on cable_tensions after the first"),
        ([COMMAND, ("tensions", LAB.cable_names[:9], [1.0] * 9)], "message 1: .*'cable_10'"),
        ([COMMAND, TENSIONS, ("tensions", LAB.cable_names, [1.0])], "tensions, message 2: effort"),
        ([("command", LAB.joint_names, [10.0] * 8), TENSIONS], "joint_commands, message 1"),
        (
            [COMMAND, TENSIONS, ("load", "segment_7", (1.0, 0.0, 0.0))],
            "segment_1, segment_2, segment_3, segment_4",
        ),
        (
            [
                COMMAND,
                ("load", "segment_1", (1.0, 0.0, 0.0)),
                ("load", "segment_3", (1.0, 0.0, 0.0)),
                TENSIONS,
            ],
            "segments 1 and 3 are loaded at once",
        ),
    ],
)
def test_a_bag_that_cannot_be_used_is_refused_in_one_line(calls, said, tmp_path):
    path = bag(tmp_path / "a.mcap", *calls)
    with pytest.raises(RecordingError, match=said) as caught:
        read_mcap(path, LAB)
    assert "\n" not in str(caught.value)
    assert "a.mcap" in str(caught.value)


def test_other_formats_and_places_are_refused(tmp_path, monkeypatch):
    with pytest.raises(RecordingError, match="no such file"):
        read_recording(tmp_path / "none.mcap", LAB)
    for path in (tmp_path / "a.bag", tmp_path):
        with pytest.raises(RecordingError, match=r"give a \.csv file, a \.mcap file"):
            read_recording(path, LAB)
    with pytest.raises(RecordingError, match=r"must be named ….mcap"):
        Bag(tmp_path / "a.db3")
    with pytest.raises(RecordingError, match="No such file or directory"):
        Bag(tmp_path / "none" / "a.mcap")
    path = bag(tmp_path / "a.mcap", COMMAND, TENSIONS)
    monkeypatch.setattr(mcap_file, "MAX_FILE_BYTES", 10)
    with pytest.raises(RecordingError, match="at most"):
        read_mcap(path, LAB)


def test_a_message_that_is_too_long_is_refused_unread(tmp_path):
    long = ("tensions", [f"cable_{i}" for i in range(20_000)], [0.0] * 20_000)
    with pytest.raises(RecordingError, match=r"/cable_tensions: .* at most 262144"):
        read_mcap(bag(tmp_path / "long.mcap", COMMAND, long), LAB)


def test_more_samples_than_memory_is_meant_for_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(mcap_file, "MAX_NUMBERS", 2 * 27)
    path = bag(tmp_path / "r.mcap", COMMAND, TENSIONS, TENSIONS)
    assert len(read_mcap(path, LAB)) == 2
    with pytest.raises(RecordingError, match="more than 2 samples"):
        read_mcap(bag(tmp_path / "s.mcap", COMMAND, *[TENSIONS] * 3), LAB)
