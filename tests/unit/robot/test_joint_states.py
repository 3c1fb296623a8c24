"""A robot's bags: which topic is read, which messages make a row, and which clock they have."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from cablesense_gap.robot.model import load_robot
from cablesense_gap.robot.recording import read_robot_recording
from cablesense_recording.recording import RecordingError
from tests.helpers.bags import START_NS, Bag, write_joint_states
from tests.helpers.two_link import JOINTS, XML, recorded, write_model

pytestmark = pytest.mark.slow  # loads the message types

MS = 1_000_000


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("states")


@pytest.fixture(scope="module")
def robot(folder):
    return load_robot(write_model(folder))


@pytest.fixture(scope="module")
def table(folder):
    return pd.read_csv(recorded(folder / "recording.csv", trials=2)).drop(columns="trial")[:200]


def states(table, names=JOINTS, efforts=True):
    """By row its time, ns, and the arguments of a message with the joints of these names."""
    for k in range(len(table)):
        row = table.iloc[k]
        fields = {"position": [row[f"position.{name}"] for name in names]}
        if efforts:
            fields["effort"] = [row[f"torque.{name}"] for name in names]
        yield START_NS + round(1e9 * row["time_s"]), list(names), fields


def two_topics(path, table, first, second, efforts=True):
    topics = (first, second)
    with Bag(path) as bag:
        for at_ns, names, fields in states(table):
            for late, topic in enumerate(topics):
                given = fields if efforts or topic == first else {"position": fields["position"]}
                bag.joint_state(topic, at_ns + late, at_ns, names, **given)
    return path


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("/left/joint_states", "/right/joint_states"),
        ("/right/joint_states", "/left/joint_states"),
        ("/desired_joint_states", "/joint_states"),
    ],
)
def test_of_two_topics_with_the_same_joints_neither_is_guessed(
    tmp_path, table, robot, first, second
):
    path = two_topics(tmp_path / "two.mcap", table, first, second)
    with pytest.raises(
        RecordingError, match=f"choose one, as with --topic {min(first, second)}"
    ) as said:
        read_robot_recording(path, robot)
    assert first in str(said.value)
    assert second in str(said.value)
    chosen = read_robot_recording(path, robot, [second])
    assert chosen.notes[0] == f"Joint states are those of {second}."
    assert len(chosen) == len(table)


def test_the_topic_that_is_read_is_always_named(tmp_path, table, robot):
    path = write_joint_states(tmp_path / "one.mcap", table, "/arm/joint_states")
    assert (
        "Joint states are those of /arm/joint_states." in read_robot_recording(path, robot).notes
    )
    with pytest.raises(
        RecordingError, match="no joint states, commands or trials on /other; it has"
    ):
        read_robot_recording(path, robot, ["/other"])


def test_a_topic_of_commands_is_no_topic_of_states(tmp_path, table, robot):
    path = two_topics(tmp_path / "two.mcap", table, "/joint_states", "/joint_commands", False)
    recording = read_robot_recording(path, robot)
    assert "Joint states are those of /joint_states." in recording.notes
    assert "Commands are those of /joint_commands." in recording.notes


@pytest.mark.parametrize("topic", ["/commander/joint_states", "/command/states"])
def test_states_of_a_commander_are_states(tmp_path, table, robot, topic):
    path = write_joint_states(tmp_path / "one.mcap", table, topic)
    assert len(read_robot_recording(path, robot)) == len(table)


def test_a_topic_that_is_called_a_command_may_be_asked_for(tmp_path, table):
    model = tmp_path / "motors.xml"
    model.write_text(XML.replace('motor name="', 'motor name="of_'))
    path = write_joint_states(tmp_path / "one.mcap", table, "/joint_commands")
    with pytest.raises(RecordingError, match="taken for commands, unless --topic names it"):
        read_robot_recording(path, load_robot(model))
    assert len(read_robot_recording(path, load_robot(model), ["/joint_commands"])) == len(table)
    path = two_topics(tmp_path / "two.mcap", table, "/joint_states", "/joint_commands", False)
    notes = read_robot_recording(path, load_robot(model)).notes
    unread = (
        "/joint_commands names none of the inputs of_shoulder, of_elbow, so no commands are read."
    )
    assert unread in notes


def test_of_several_topics_of_commands_that_of_the_namespace_counts(tmp_path, table, robot):
    for name, topics, says in (
        ("a.mcap", ("/left/joint_commands", "/right/joint_commands"), None),
        (
            "b.mcap",
            ("/a_commands", "/b_commands"),
            "/a_commands and /b_commands have commands each",
        ),
    ):
        with Bag(tmp_path / name) as bag:
            for at_ns, names, fields in states(table):
                for topic in topics:
                    bag.joint_state(topic, at_ns - 1, at_ns, names, position=fields["effort"])
                bag.joint_state("/left/joint_states", at_ns, at_ns, names, **fields)
        if says:
            with pytest.raises(RecordingError, match=says):
                read_robot_recording(tmp_path / name, robot)
        else:
            notes = read_robot_recording(tmp_path / name, robot).notes
            assert "Commands are those of /left/joint_commands." in notes


@pytest.mark.parametrize(
    "names",
    [
        ("arm:shoulder 1", "arm:elbow 1"),
        ("arm.shoulder", "arm.elbow"),
        ("schulter_ö", "schulter_ä"),
        ("关节_1", "关节_2"),
        ("a:1", "a.1"),
    ],
)
def test_joints_are_matched_by_the_names_that_the_model_has(tmp_path, table, names):
    xml = XML
    for joint, name in zip(JOINTS, names, strict=True):
        xml = xml.replace(f'joint name="{joint}"', f'joint name="{name}"')
        xml = xml.replace(f'joint="{joint}"', f'joint="{name}"')
    model = tmp_path / "named.xml"
    model.write_text(xml, encoding="utf-8")
    robot = load_robot(model)
    assert robot.joint_names == names
    assert len(set(robot.joints)) == 2
    by_bag = read_robot_recording(
        write_joint_states(
            tmp_path / "named.mcap", table, joints=dict(zip(JOINTS, names, strict=True))
        ),
        robot,
    )
    for spelled in (names, robot.joints):
        renamed = table.copy()
        for joint, name in zip(JOINTS, spelled, strict=True):
            renamed = renamed.rename(
                columns=lambda c, j=joint, n=name: c.replace(f".{j}", f".{n}")
            )
        renamed.to_csv(tmp_path / "named.csv", index=False)
        by_csv = read_robot_recording(tmp_path / "named.csv", robot)
        assert by_csv.position == pytest.approx(by_bag.position)


def test_a_letter_that_is_spelled_in_two_ways_is_one(tmp_path, table):
    model = tmp_path / "named.xml"
    model.write_text(XML.replace('"elbow"', '"gel\u00e4nk"'), encoding="utf-8")
    other = {"shoulder": "shoulder", "elbow": "gela\u0308nk"}
    path = write_joint_states(tmp_path / "named.mcap", table, joints=other)
    assert len(read_robot_recording(path, load_robot(model))) == len(table)


@pytest.mark.parametrize("topics", [("/joint_states",) * 2, ("/arm/joint_states", "/hand/states")])
def test_joints_in_messages_of_their_own_are_merged(tmp_path, table, robot, topics):
    path = tmp_path / "parted.mcap"
    with Bag(path) as bag:
        for k, (at_ns, _, fields) in enumerate(states(table)):
            for joint, topic in enumerate(topics):
                if joint and k % 2:  # the second driver is half as fast
                    continue
                given = {name: values[joint : joint + 1] for name, values in fields.items()}
                bag.joint_state(topic, at_ns + joint, at_ns, [JOINTS[joint]], **given)
    recording = read_robot_recording(path, robot)
    expected = table[::2]
    assert recording.time_s == pytest.approx(expected.time_s - expected.time_s.iloc[0])
    for joint, name in enumerate(JOINTS):
        assert recording.position[:, joint] == pytest.approx(expected[f"position.{name}"])
        assert recording.torque[:, joint] == pytest.approx(expected[f"torque.{name}"])
    assert any("No message has all joints: shoulder; elbow" in note for note in recording.notes)


def test_nothing_is_merged_across_a_pause_of_one_driver(tmp_path, table, robot):
    path = tmp_path / "paused.mcap"
    with Bag(path) as bag:
        for k, (at_ns, _, fields) in enumerate(states(table)):
            for joint in range(2):
                if joint == 0 and 80 <= k < 120:
                    continue
                given = {name: values[joint : joint + 1] for name, values in fields.items()}
                bag.joint_state("/joint_states", at_ns + joint, at_ns, [JOINTS[joint]], **given)
    recording = read_robot_recording(path, robot)
    expected = table.drop(index=range(80, 120))
    assert recording.position[:, 1] == pytest.approx(expected["position.elbow"])
    assert any("before row 81: the trial is parted" in note for note in recording.notes)


def test_a_joint_that_stands_twice_in_a_message_is_refused(tmp_path, table, robot):
    path = tmp_path / "twice.mcap"
    with Bag(path) as bag:
        for at_ns, names, fields in states(table):
            stale = {name: [*values, 0.0, 0.0] for name, values in fields.items()}
            bag.joint_state("/joint_states", at_ns, at_ns, names * 2, **stale)
    with pytest.raises(
        RecordingError, match="/joint_states, message 1: name: shoulder, elbow stands twice"
    ):
        read_robot_recording(path, robot)


def test_a_message_with_too_few_values_is_refused(tmp_path, table, robot):
    path = tmp_path / "few.mcap"
    with Bag(path) as bag:
        for at_ns, names, fields in states(table):
            bag.joint_state("/joint_states", at_ns, at_ns, names, **fields | {"effort": [1.0]})
    with pytest.raises(RecordingError, match="message 1: effort holds 1 values for 2 names"):
        read_robot_recording(path, robot)


@pytest.mark.parametrize(
    "efforts", [[], [np.nan, np.nan], [0.0, 0.0]], ids=["none", "nan", "zero"]
)
def test_rows_begin_where_efforts_do(tmp_path, table, robot, efforts):
    path = tmp_path / "late.mcap"
    with Bag(path) as bag:
        for k, (at_ns, names, fields) in enumerate(states(table)):
            message_fields = fields | {"effort": efforts} if k < 50 else fields
            bag.joint_state("/joint_states", at_ns, at_ns, names, **message_fields)
    recording = read_robot_recording(path, robot)
    assert len(recording) == len(table) - 50
    expected = "The first 50 of 200 rows are left out, before all torques have begun."
    assert expected in recording.notes


@pytest.mark.parametrize("efforts", [None, [0.0, 0.0]], ids=["without efforts", "with efforts"])
@pytest.mark.parametrize("every", [1, 2, 10])
def test_a_second_publisher_on_the_topic_is_refused(tmp_path, table, robot, every, efforts):
    path = tmp_path / "both.mcap"
    with Bag(path) as bag:
        for k, (at_ns, names, fields) in enumerate(states(table)):
            bag.joint_state("/joint_states", at_ns, at_ns, names, **fields)
            if k % every == 0:
                stale = {"position": [0.0, 0.0]} | ({"effort": efforts} if efforts else {})
                bag.joint_state("/joint_states", at_ns + 4 * MS, at_ns + 4 * MS, names, **stale)
    with pytest.raises(RecordingError, match=r"publisher"):
        read_robot_recording(path, robot)


def stamped(path, table, stamp_of):
    with Bag(path) as bag:
        for k, (at_ns, names, fields) in enumerate(states(table)):
            log_ns = 100 * START_NS + at_ns
            bag.joint_state("/joint_states", log_ns, stamp_of(k, at_ns), names, **fields)
    return path


def test_simulated_time_may_begin_at_zero(tmp_path, table, robot):
    path = stamped(tmp_path / "sim.mcap", table, lambda k, at_ns: k * 10 * MS // 2)
    assert read_robot_recording(path, robot).time_s == pytest.approx(0.005 * np.arange(len(table)))


@pytest.mark.parametrize("missing", [{0}, {7, 8}, set(range(200))])
def test_rows_have_one_clock_where_stamps_are_missing(tmp_path, table, robot, missing):
    wall = stamped(
        tmp_path / "wall.mcap", table, lambda k, at_ns: 0 if k in missing else 5 * START_NS + at_ns
    )
    recording = read_robot_recording(wall, robot)
    assert recording.time_s == pytest.approx(table.time_s - table.time_s.iloc[0])
    assert (len(missing) == 200) != any("Stamps are missing" in note for note in recording.notes)


def test_drivers_with_other_clocks_are_ordered_by_arrival(tmp_path, table, robot):
    path = tmp_path / "clocks.mcap"
    with Bag(path) as bag:
        for at_ns, _, fields in states(table):
            for joint in range(2):
                given = {name: values[joint : joint + 1] for name, values in fields.items()}
                stamp_ns = at_ns + joint * 1_000 * START_NS
                bag.joint_state("/joint_states", at_ns, stamp_ns, [JOINTS[joint]], **given)
    recording = read_robot_recording(path, robot)
    assert recording.position[:, 1] == pytest.approx(table["position.elbow"])
    assert "Stamps are of several clocks, so the times of arrival count." in recording.notes
