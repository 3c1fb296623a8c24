"""Recordings of robots: what is read, and what is refused in one line."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from cablesense_gap.robot.amending import load_amended, write_amended
from cablesense_gap.robot.inverse import InverseDynamics
from cablesense_gap.robot.model import RobotError, load_robot
from cablesense_gap.robot.motion import Trajectory
from cablesense_gap.robot.preparation import prepared
from cablesense_gap.robot.recording import channels_of, read_robot_recording
from cablesense_gap.simulator import Term
from cablesense_msgs_py.topics import CABLE_TENSIONS, JOINT_COMMANDS
from cablesense_recording import csv_file, joint_states, mcap_file
from cablesense_recording.joint_states import bag_table
from cablesense_recording.recording import RecordingError
from tests.helpers.bags import Bag
from tests.helpers.two_link import recorded, write_model

BODY = "<mujoco><worldbody><body>{}<geom size='1'/></body></worldbody></mujoco>"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("robot")


@pytest.fixture(scope="module")
def robot(folder):
    return load_robot(write_model(folder))


@pytest.fixture(scope="module")
def table(folder):
    return pd.read_csv(recorded(folder / "recording.csv", trials=3))


def read(tmp_path, table, robot, name="changed.csv"):
    table.to_csv(tmp_path / name, index=False)
    return read_robot_recording(tmp_path / name, robot)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (
            lambda t: t.drop(columns="position.elbow"),
            "misses the position of elbow; robot.xml has",
        ),
        (lambda t: t.drop(columns="time_s"), "misses column time_s"),
        (lambda t: t.rename(columns={"time_s": "time_ms"}), "time_ms is there: it must be time_s"),
        (lambda t: t.assign(time_s=1e3 * t.time_s), "milliseconds given"),
        (lambda t: t.assign(time_s=1e6 * t.time_s), "microseconds given"),
        (lambda t: t.head(400).assign(time_s=1e9 * t.time_s), r"\(nanoseconds given"),
        (lambda t: t.assign(time_s=1e9 * t.time_s), "beyond 1e\\+10 s; times must be in seconds"),
        (lambda t: t.assign(time_s=-t.time_s), "runs back"),
        (lambda t: t.rename(columns=lambda c: c.replace("elbow", "knee")), "has knee, which the"),
        (lambda t: t.assign(**{"position.elbow": 60.0 * t["position.elbow"]}), "degrees given"),
        (lambda t: t.assign(**{"torque.elbow": "much"}), "'much' is no number"),
        (lambda t: t.assign(**{"position.elbow": np.nan}), "column position.elbow: empty"),
        (lambda t: t.assign(time_s=t.time_s.where(t.index != 50)), "row 51, column time_s: empty"),
        (
            lambda t: t.assign(**{"torque.elbow": t["torque.elbow"].where(t.index != 50)}),
            "column torque.elbow: empty or not finite; fill every row, or leave the column out",
        ),
        (
            lambda t: t.assign(**{"position.elbow": 0.0, "position.shoulder": 0.0}),
            "no joint moves",
        ),
        (lambda t: t.head(1), "has 1 rows"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(tmp_path, table, robot, change, says):
    with pytest.raises(RecordingError, match=says) as refused:
        read(tmp_path, change(table), robot)
    assert "\n" not in str(refused.value)


def test_with_force_a_drum_may_turn_far(tmp_path, table, robot):
    table = table.assign(**{"position.elbow": 60.0 * table["position.elbow"]})
    table.to_csv(tmp_path / "drum.csv", index=False)
    with pytest.raises(RecordingError, match="continue with --force"):
        read_robot_recording(tmp_path / "drum.csv", robot)
    recording = read_robot_recording(tmp_path / "drum.csv", robot, force=True)
    assert any("degrees given?" in warning for warning in recording.warnings)


def test_without_torques_and_commands_nothing_can_be_compared(tmp_path, table, robot):
    recording = read(tmp_path, table.drop(columns=["torque.shoulder", "torque.elbow"]), robot)
    with pytest.raises(RecordingError, match="has neither torque"):
        prepared(recording, robot)


def test_files_of_a_folder_are_trials_and_time_may_begin_anew(tmp_path, table, robot):
    for trial, own in table.groupby("trial"):
        own = own.assign(time_s=own.time_s - own.time_s.iloc[0]).drop(columns="trial")
        own.to_csv(tmp_path / f"run_{trial}.csv.gz", index=False)
    whole = read_robot_recording(tmp_path, robot)
    assert len(whole) == len(table)
    # three are too few to hold some out, so each is cut
    assert whole.trial.max() + 1 >= 5
    assert "cut into" in whole.notes[0]


def test_trials_are_called_by_their_numbers_in_the_file(tmp_path, table, robot):
    numbers = table.trial.map({0: -4, 1: 1_234_567, 2: 9})
    recording = read(tmp_path, table.assign(trial=numbers), robot)
    labels = [recording.trial_label(trial) for trial in recording.trial.tolist()]
    assert recording.trial.max() + 1 >= 5  # three are too few, so each is cut
    assert labels == numbers.tolist()


def test_trials_of_several_files_are_called_by_number_and_file(tmp_path, table, robot):
    for name in ("first.csv", "second.csv"):
        table.assign(trial=table.trial + 3).to_csv(tmp_path / name, index=False)
    recording = read_robot_recording(tmp_path, robot)
    labels = dict.fromkeys(recording.trial_label(trial) for trial in recording.trial.tolist())
    assert list(labels) == [
        f"{n} of {name}.csv" for name in ("first", "second") for n in (3, 4, 5)
    ]


def test_trials_without_numbers_are_counted_in_each_file(tmp_path, table, robot):
    for trial, rows in table.drop(columns="trial").groupby(table.trial):
        rows.to_csv(tmp_path / f"run_{trial}.csv", index=False)
    recording = read_robot_recording(tmp_path, robot)
    labels = [f"{k} of run_{n}.csv" for n in range(3) for k in range(3)]
    assert list(recording.trial_labels) == labels


@pytest.mark.slow  # loads the message types
def test_a_bag_of_joint_states_is_read_as_its_csv(tmp_path, table, robot):
    path = tmp_path / "run.mcap"
    table = table[::4]
    names = ["elbow", "shoulder", "gripper"]  # of any order, and more than the model's
    with Bag(path) as bag:
        for k, row in enumerate(table.to_dict("records")):
            bag.trial(2 * k + 1, int(row["trial"]))
            stamp_ns = 1_000_000_000 + round(1e9 * row["time_s"])
            position, effort = (
                [row[f"{kind}.elbow"], row[f"{kind}.shoulder"], 0.0]
                for kind in ("position", "torque")
            )
            bag.joint_state(
                CABLE_TENSIONS, 2 * k + 2, stamp_ns, names, position=position, effort=effort
            )
    by_csv = read(tmp_path, table, robot)
    by_bag = read_robot_recording(path, robot)
    assert by_bag.time_s == pytest.approx(by_csv.time_s)
    assert by_bag.position == pytest.approx(by_csv.position)
    assert by_bag.torque == pytest.approx(by_csv.torque)
    assert (by_bag.trial == by_csv.trial).all()
    other = tmp_path / "other.xml"
    other.write_text(Path(robot.path).read_text().replace("elbow", "knee"))
    with pytest.raises(RecordingError, match="with the joints shoulder, knee; it names elbow"):
        read_robot_recording(path, load_robot(other))


@pytest.mark.slow  # loads the message types
def test_a_recording_that_is_too_large_or_not_there_is_refused_in_one_line(
    tmp_path, table, robot, monkeypatch
):
    path = tmp_path / "run.mcap"
    with pytest.raises(RecordingError, match=r"^\S*run\.mcap: no such file$"):
        read_robot_recording(path, robot)
    with Bag(path) as bag:
        bag.joint_state(CABLE_TENSIONS, 1, 1, robot.joints, position=[0.0, 0.0])
    for module in (csv_file, joint_states):
        monkeypatch.setattr(module, "MAX_NUMBERS", 5)
    with pytest.raises(RecordingError, match=r"^\S*run\.mcap: more than 5 numbers; split it$"):
        read_robot_recording(path, robot)
    with pytest.raises(RecordingError, match="more than 5 numbers; split it"):
        read(tmp_path, table, robot, "packed.csv.gz")
    monkeypatch.setattr(mcap_file, "MAX_FILE_BYTES", 10)
    with pytest.raises(RecordingError, match=r"^\S*run\.mcap: 0\.0 GB; a recording has at most"):
        read_robot_recording(path, robot)


@pytest.mark.slow  # loads the message types
def test_a_bag_without_torques_begins_with_its_first_command_and_any_trial(tmp_path, table, robot):
    path = tmp_path / "run.mcap"
    names = list(robot.joints)
    with Bag(path) as bag:
        for k, row in enumerate(table[:60].to_dict("records")):
            if k == 30:
                bag.trial(10 * k + 1, 7)
            stamp_ns = 1_000_000_000 + round(1e9 * row["time_s"])
            if k >= 20:
                command = [row[f"torque.{name}"] for name in names]
                bag.joint_state(JOINT_COMMANDS, 10 * k + 2, stamp_ns, names, position=command)
            position = [row[f"position.{name}"] for name in names]
            bag.joint_state(CABLE_TENSIONS, 10 * k + 3, stamp_ns, names, position=position)
    recording = read_robot_recording(path, robot)
    assert np.ptp(recording.time_s) == pytest.approx(table.time_s[59] - table.time_s[20])
    assert recording.command[:, 1] == pytest.approx(table["torque.elbow"][20:60].to_numpy())
    assert (
        "The first 20 of 60 rows are left out, before all commands have begun." in recording.notes
    )
    numbered, _ = bag_table(path, channels_of(robot))
    assert (np.diff(numbered["trial"]) != 0).nonzero()[0].tolist() == [29]


def test_trials_are_parted_by_pauses(tmp_path, table, robot):
    moving = table[table.trial == 0]
    parts = []
    begin = 0.0
    for _ in range(6):
        for own in (moving, moving.tail(1).loc[moving.index[-1:].repeat(100)]):
            time_s = begin + 0.01 * np.arange(len(own))
            parts.append(own.assign(time_s=time_s))
            begin = time_s[-1] + 0.01
    found = read(tmp_path, pd.concat(parts).drop(columns="trial"), robot)
    lengths = np.bincount(found.trial)
    assert len(lengths) in (6, 7)
    assert lengths[1:5] == pytest.approx(500, abs=30)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("<mujoco/>", "has no joints"),
        (BODY.format("<freejoint/>"), "free"),
        (BODY.format("<joint/>"), "no name"),
        ("<robot", "cannot read this"),
    ],
)
def test_models_that_cannot_be_used_are_refused(tmp_path, text, says):
    path = tmp_path / "model.xml"
    path.write_text(text)
    with pytest.raises(RobotError, match=says):
        load_robot(path)


URDF = """<robot name="crank">
<link name="base"/>
<link name="flange"><visual><geometry><mesh filename="package://far/a.stl"/></geometry></visual>
  <inertial><mass value="1"/><origin xyz="0 0 0.1"/>
  <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="arm"><collision><geometry><mesh filename="package://far/b.stl"/></geometry></collision>
  <inertial><mass value="2"/><origin xyz="0.1 0 0"/>
  <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="fixed" type="fixed"><parent link="base"/><child link="flange"/></joint>
<joint name="turn" type="revolute"><parent link="flange"/><child link="arm"/><axis xyz="0 1 0"/>
  <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
</robot>"""


def test_a_urdf_is_read_without_its_meshes_and_amended_as_mjcf(tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_text(URDF)
    robot = load_robot(path)
    assert (robot.joints, robot.bodies) == (("turn",), ("arm",))
    named_values = {
        Term("link_mass", "arm", "share"): 0.25,
        Term("joint_friction", "turn", "torque_n_m"): 0.3,
        Term("torque_scale", "turn", "share"): 0.1,
    }
    write_amended(tmp_path, robot, named_values, {})
    amended, beside = load_amended(tmp_path)
    written = (tmp_path / "amended_model.xml").read_text()
    assert " simple=" not in written  # MuJoCo 3.2 knows no such attribute
    assert amended.nominal().mass_kg == pytest.approx([2.5])
    assert amended.nominal().friction == pytest.approx([0.3])
    assert beside == {Term("torque_scale", "turn", "share"): 0.1}


MASSLESS = """<robot name="shapes"><link name="base"/>
<link name="a"><collision><geometry><box size="0.05 0.05 0.3"/></geometry></collision></link>
<link name="tip"/>{}
<joint name="fixed" type="fixed"><parent link="a"/><child link="tip"/></joint>
<joint name="j1" type="continuous"><axis xyz="0 1 0"/><parent link="base"/><child
  link="a"/></joint>
</robot>"""
HAND = """<link name="hand"><inertial><mass value="1"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="hold" type="fixed"><parent link="tip"/><child link="hand"/></joint>"""


def test_a_urdf_without_masses_names_the_link(tmp_path):
    path = tmp_path / "shapes.urdf"
    path.write_text(MASSLESS.format(""))
    with pytest.raises(RobotError, match="link a has no <inertial> with a mass; masses from"):
        load_robot(path)
    path.write_text(MASSLESS.format(HAND))  # what is fixed to a link has its mass
    assert load_robot(path).joints == ("j1",)


@pytest.mark.parametrize("name", ["arm.xacro", "arm.urdf.xacro", "arm.urdf"])
def test_a_xacro_file_says_how_it_is_expanded(tmp_path, name):
    path = tmp_path / name
    into = "arm.urdf" if name.endswith("xacro") else "arm_expanded.urdf"
    for part in ('<xacro:arm prefix=""/>', '<link name="${prefix}base"/>'):
        path.write_text(f'<robot name="arm" xmlns:xacro="x">{part}</robot>')
        with pytest.raises(RobotError, match=f"a xacro file; expand it: xacro {name} > {into}$"):
            load_robot(path)
    expanded = URDF.replace("<robot", '<robot xmlns:xacro="x"')
    path.write_text(f"<!-- by <xacro:arm/> -->{expanded}")
    assert load_robot(path).joints == ("turn",)


def test_a_model_whose_path_is_no_utf8_is_refused_in_one_line(tmp_path):
    path = write_model(tmp_path).rename(
        tmp_path / b"r\xf6bot.xml".decode(errors="surrogateescape")
    )
    with pytest.raises(RobotError, match="the path is no UTF-8 text") as said:
        load_robot(path)
    assert str(said.value).isascii()


def course(position, speed=0.0, acceleration=0.0):
    count, joints = position.shape
    still = np.zeros_like(position)
    return Trajectory(
        time_s=np.arange(float(count)),
        trial=np.zeros(count, dtype=np.int64),
        position=position,
        speed=still + speed,
        acceleration=still + acceleration,
        direction=np.ones((count, joints)),
        load=still,
        command=np.empty((count, 0)),
    )


def test_a_drive_that_moves_two_joints_keeps_its_rotor_and_gives_the_power(robot):
    rng = np.random.default_rng(1)
    position, speed, acceleration = rng.normal(size=(3, 40, 2))
    coupling = np.array([[0.0, 0.0], [0.3, 0.0]])
    change = robot.nominal()
    change.coupling[:] = coupling
    change.armature[:] = [0.01, 0.02]
    change.damping[:] = 0.1
    drive = InverseDynamics(robot, course(position, speed, acceleration)).torques(change)
    joint = [each + each @ coupling.T for each in (position, speed, acceleration)]
    bodies = InverseDynamics(robot, course(*joint)).torques(robot.nominal())
    rotor = change.armature * acceleration + change.damping * speed
    assert (drive * speed).sum(1) == pytest.approx((bodies * joint[1] + rotor * speed).sum(1))


def test_what_drives_a_geared_joint_bears_its_torque_less_its_load(tmp_path):
    path = tmp_path / "geared.xml"
    joint = "<body name='{0}'><joint name='{0}' axis='0 0 1'/><geom size='0.1' mass='2'/></body>"
    tied = "<equality><joint joint1='b' joint2='a' polycoef='0.1 -2 0 0 0'/></equality>"
    both = joint.format("a") + joint.format("b")
    path.write_text(f"<mujoco><worldbody>{both}</worldbody>{tied}</mujoco>")
    robot = load_robot(path)
    inertia = 0.4 * 2.0 * 0.1**2  # of a ball
    moved = course(np.zeros((3, 2)), acceleration=[1.0, -2.0])
    moved = replace(moved, load=np.array([[0.0, 0.3]] * 3))
    torque = InverseDynamics(robot, moved).torques(robot.nominal())[0, 0]
    assert torque == pytest.approx(inertia * 1.0 - 2.0 * (inertia * -2.0 - 0.3))
