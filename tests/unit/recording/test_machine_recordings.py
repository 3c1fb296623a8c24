"""Recordings of machines that MuJoCo describes: as CSV and as bags, and what is refused."""

import numpy as np
import pandas as pd
import pytest
import yaml

from cablesense_contact.unloaded_holds import unloaded_holds, with_held_positions
from cablesense_msgs_py import topics
from cablesense_recording.column_map import read_column_map
from cablesense_recording.layout import layout_of
from cablesense_recording.reading import read_recording
from cablesense_recording.recording import RecordingError
from cablesense_sim.machine.machine import open_machine
from tests.helpers.bags import Bag
from tests.helpers.example_machines import example_machine

S = 1_000_000_000
FINGER = example_machine("finger")
SIX_AXIS = example_machine("six_axis")


def table(machine, rows=30, seed=0):
    """Columns of a recording: two commands, one after the other."""
    layout = layout_of(machine)
    rng = np.random.default_rng(seed)
    held = np.repeat(rng.uniform(-0.1, 0.1, (2, len(layout.command_names))), rows // 2, axis=0)
    columns = {"time_s": 0.1 * np.arange(rows)}
    columns |= dict(zip(layout.command_columns, held.T, strict=True))
    readings = rng.uniform(50, 60, (rows, len(layout.channel_names)))
    return columns | dict(zip(layout.reading_columns, readings.T, strict=True))


def written(path, columns):
    pd.DataFrame(columns).to_csv(path, index=False)
    return path


def test_columns_have_the_names_of_the_model(tmp_path):
    columns = table(FINGER)
    assert {"command.bend", "tension.flexor_deep"} < set(columns)
    recording = read_recording(written(tmp_path / "a.csv", columns), FINGER)
    np.testing.assert_allclose(recording.tensions_n[:, 0], columns["tension.flexor_deep"])
    assert not recording.load_segment.any()
    assert len(np.unique(recording.trial)) == 2  # by the second command
    # a robot's recording holds more of it than is read
    of_robot = table(SIX_AXIS) | {"torque.gripper": np.zeros(30), "position.gripper": 1.0}
    measured = read_recording(written(tmp_path / "b.csv", of_robot), SIX_AXIS)
    assert measured.tensions_n.shape == (30, 6)


def test_loads_are_of_the_links_of_the_machine_file(tmp_path):
    load = {"load_segment": np.repeat([0, 2], 15), "load_x_n": 0.0, "load_y_n": 0.0}
    columns = table(FINGER) | load | {"load_z_n": np.repeat([0.0, 1.5], 15)}
    recording = read_recording(written(tmp_path / "a.csv", columns), FINGER)
    assert set(recording.load_segment) == {0, 2}
    for change, said in (
        ({"load_segment": np.full(30, 4)}, "from 1 to 3"),
        ({"load_at_m": np.full(30, 0.1)}, "on distal it must be from 0.005 to 0.027 m"),
    ):
        with pytest.raises(RecordingError, match=said):
            read_recording(written(tmp_path / "b.csv", columns | change), FINGER)
    del columns["load_z_n"]
    with pytest.raises(RecordingError, match="misses load_z_n"):
        read_recording(written(tmp_path / "c.csv", columns), FINGER)


def test_a_missing_channel_is_named(tmp_path):
    columns = table(FINGER)
    del columns["tension.extensor"]
    with pytest.raises(RecordingError, match=r"misses tension.extensor; .* machine finger has"):
        read_recording(written(tmp_path / "a.csv", columns), FINGER)


def test_a_bag_of_commands_and_loads(tmp_path):
    path = tmp_path / "a.mcap"
    with Bag(path) as bag:
        bag.joint_state(topics.JOINT_COMMANDS, S, S, ["bend"], position=[0.1])
        bag.joint_state(topics.JOINT_STATES, S, S, ["bend"], position=[0.2])
        for row in range(4):
            stamp = S + row * S // 10
            if row == 2:
                bag.load(stamp, stamp, "lab/distal", (0.0, 0.0, 1.0))
            names = FINGER.channels.names
            bag.joint_state(topics.CABLE_TENSIONS, stamp, stamp, names, effort=[50.0] * 4)
    recording = read_recording(path, FINGER)
    np.testing.assert_array_equal(recording.command_rad[0], [0.0, 0.1, 0.0])
    np.testing.assert_array_equal(recording.load_segment, [0, 0, 2, 2])


def measured_bag(path, readings_topic=topics.CABLE_TENSIONS):
    """Two poses of the arm with torque sensors, whose encoders have noise."""
    rng = np.random.default_rng(0)
    joints = SIX_AXIS.coordinates.names
    with Bag(path) as bag:
        for row in range(60):
            stamp = S + row * S // 10
            pose = 0.2 * (row >= 30) + rng.normal(0.0, 1e-5, 6)
            torques = np.full(6, float(row >= 30))
            if readings_topic == topics.JOINT_STATES:
                fields = {"position": pose, "effort": torques}
                bag.joint_state(topics.JOINT_STATES, stamp, stamp, joints, **fields)
                continue
            bag.joint_state(topics.JOINT_STATES, stamp, stamp, joints, position=pose)
            bag.joint_state(readings_topic, stamp, stamp, joints, effort=torques)
    return path


def test_measured_positions_make_poses_though_they_have_noise(tmp_path):
    recording = read_recording(measured_bag(tmp_path / "a.mcap"), SIX_AXIS)
    holds = unloaded_holds(with_held_positions(recording))
    assert [round(hold.command_rad[0], 3) for hold in holds] == [0.0, 0.2]
    assert [hold.reading_n[0] for hold in holds] == [0.0, 1.0]
    assert holds[1].count == 20  # after a second to settle
    # noise is averaged away
    assert np.abs(holds[1].command_rad - 0.2).max() < 1e-5


def test_a_driver_that_publishes_torques_as_efforts_is_read_by_a_map(tmp_path):
    path = measured_bag(tmp_path / "a.mcap", topics.JOINT_STATES)
    with pytest.raises(RecordingError, match="misses cable_tensions"):
        read_recording(path, SIX_AXIS)
    columns = tmp_path / "map.yaml"
    columns.write_text("tensions: {topic: /joint_states}\n")
    recording = read_recording(path, SIX_AXIS, columns=read_column_map(columns, SIX_AXIS))
    np.testing.assert_array_equal(recording.tensions_n[[0, 59], 0], [0.0, 1.0])


@pytest.mark.parametrize(
    ("name", "tensions", "commands", "per_reading", "per_command"),
    [
        ("continuum", "kgf", "mm", 9.80665, 1e-3),
        ("finger", "mN", "deg", 1e-3, np.pi / 180.0),
        ("six_axis", "N·cm", "mrad", 1e-2, 1e-3),
    ],
)
def test_a_map_may_give_lengths_and_torques(
    tmp_path, name, tensions, commands, per_reading, per_command
):
    machine = example_machine(name)
    meant = tmp_path / "map.yaml"
    text = f"tensions: {{unit: {tensions}}}\ncommands: {{unit: {commands}, offset: 0.25}}\n"
    meant.write_text(text, "utf-8")
    columns = table(machine)
    recording = read_recording(
        written(tmp_path / "a.csv", columns), machine, columns=read_column_map(meant, machine)
    )
    layout = layout_of(machine)
    readings = np.transpose([columns[name] for name in layout.reading_columns])
    np.testing.assert_allclose(recording.tensions_n, per_reading * readings)
    command = np.transpose([columns[name] for name in layout.command_columns])
    np.testing.assert_allclose(recording.command_rad, per_command * (0.25 + command))


def test_an_offset_is_of_all_numbers_or_one_for_each(tmp_path):
    meant = tmp_path / "map.yaml"
    meant.write_text("commands: {scale: -1, offset: [0.1, 0.2, 0.3]}\n", "utf-8")
    columns = read_column_map(meant, FINGER)
    np.testing.assert_allclose(columns.commanded(np.full((2, 3), 0.1)), [[0.0, 0.1, 0.2]] * 2)
    meant.write_text("commands: {offset: [0.1, 0.2]}\n", "utf-8")
    with pytest.raises(RecordingError, match=r"commands.offset has 2 entries; .* needs 3"):
        read_column_map(meant, FINGER)


def test_a_force_sensor_at_the_only_link_says_when_it_is_loaded(tmp_path):
    text = FINGER.source.path.read_text("utf-8")
    one_link = tmp_path / "finger.yaml"
    model = FINGER.source.model_path
    described = yaml.safe_load(text) | {"model": str(model)}
    described["touch"]["links"] = described["touch"]["links"][-1:]
    one_link.write_text(yaml.safe_dump(described), "utf-8")
    machine = open_machine(one_link)
    columns = table(machine) | {"fx": 0.01, "fy": 0.0, "fz": np.repeat([0.02, 1.5], 15)}
    meant = tmp_path / "map.yaml"
    meant.write_text("loads: {force: [fx, fy, fz], unit: N, least: 0.03}\n", "utf-8")
    recording = read_recording(
        written(tmp_path / "a.csv", columns), machine, columns=read_column_map(meant, machine)
    )
    assert recording.load_segment.tolist() == [0] * 15 + [1] * 15
    np.testing.assert_allclose(recording.load_n[:15], 0.0)
    np.testing.assert_allclose(recording.load_n[15:], [[0.01, 0.0, 1.5]] * 15)
    columns = table(FINGER) | {"fx": 0.01, "fy": 0.0, "fz": 1.5}
    with pytest.raises(RecordingError, match="load_segment"):
        read_recording(
            written(tmp_path / "b.csv", columns), FINGER, columns=read_column_map(meant, FINGER)
        )
