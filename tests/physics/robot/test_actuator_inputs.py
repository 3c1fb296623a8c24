"""Actuators with several inputs, or with none, beside others: each command goes where it acts."""

from dataclasses import replace

import mujoco
import numpy as np
import pandas as pd
import pytest

from cablesense_gap.robot import doubts
from cablesense_gap.robot.inverse import Servos
from cablesense_gap.robot.model import actuated, load_robot
from cablesense_gap.robot.preparation import prepared
from cablesense_gap.robot.protocol import next_experiment
from cablesense_gap.robot.recording import read_robot_recording
from cablesense_gap.robot.system import RobotSystem, wrong_columns
from cablesense_gap.simulator import Term
from cablesense_recording.recording import RecordingError
from tests.helpers.two_link import JOINTS, XML, model_torques, motion
from tests.physics.robot.test_tendons import FINGER, torques, waves

TWO_INPUTS = '<pid name="{0}" joint="{0}" kp="30" kv="0.3" input="pos vel"/>'
PASSIVE = '<dcmotor name="brake" joint="elbow" motorconst="0.01" resistance="1" input="none"/>'


def with_actuators(path, actuators):
    head, _, _ = XML.partition("<actuator>")
    path.write_text(f"{head}<actuator>{actuators}</actuator></mujoco>")
    return load_robot(path)


@pytest.fixture
def robot(tmp_path):
    both = TWO_INPUTS.format("shoulder") + '<position name="elbow" joint="elbow" kp="40"/>'
    return with_actuators(tmp_path / "inputs.xml", PASSIVE + both)


def commanded(path, robot):
    """A recording whose commands hold the nominal robot on its motion."""
    rng = np.random.default_rng(0)
    tables = []
    for trial in range(6):
        time_s, position, speed, acceleration = motion(rng)
        torque = model_torques(position, speed, acceleration)
        columns = {"time_s": time_s + 10.0 * trial, "trial": trial}
        for j, name in enumerate(JOINTS):
            columns[f"position.{name}"] = position[:, j]
        back_emf = 0.01**2 * speed[:, 1]
        columns["command.shoulder.pos"] = position[:, 0] + torque[:, 0] / 30.0
        columns["command.shoulder.vel"] = speed[:, 0]
        columns["command.elbow"] = position[:, 1] + (torque[:, 1] + back_emf) / 40.0
        tables.append(pd.DataFrame(columns))
    pd.concat(tables).to_csv(path, index=False)
    return read_robot_recording(path, robot)


def test_inputs_have_names_of_their_own(robot):
    assert robot.actuators == ("brake", "shoulder", "elbow")
    assert robot.controls == ("shoulder.pos", "shoulder.vel", "elbow")
    assert robot.servos.tolist() == [-1, 2]
    assert robot.servo_controls.tolist() == [-1, 2]
    with pytest.raises(RecordingError, match="shoulder without a position servo"):
        Servos.of(robot)


def test_commands_of_several_inputs_hold_the_robot_on_its_motion(tmp_path, robot):
    recording = commanded(tmp_path / "run.csv", robot)
    assert not wrong_columns(recording, robot)
    assert not doubts.beyond_range(recording, robot)
    plain = with_actuators(
        tmp_path / "plain.xml",
        '<position name="shoulder" joint="shoulder" kp="30" kv="0.3"/>'
        '<position name="elbow" joint="elbow" kp="40"/>',
    )
    # a damper of 0.3 that is not told the speed, and the same force
    shoulder = recording.command[:, 0] + 0.3 / 30.0 * recording.command[:, 1]
    command = np.column_stack([shoulder, recording.command[:, 2]])
    of_plain = gaps(replace(recording, command=command), plain)
    assert gaps(recording, robot) == pytest.approx(of_plain, rel=0.05)


def gaps(recording, robot):
    """By channel, as a share of what was measured."""
    system = RobotSystem(robot, prepared(recording, robot), {})
    return [gap / size for _, _, gap, size in system.gaps()]


def test_what_actuators_make_is_what_mujoco_says(robot):
    rng = np.random.default_rng(0)
    position, speed = rng.uniform(-0.5, 0.5, (2, 20, 2))
    command = rng.uniform(-0.5, 0.5, (20, 3))
    made = actuated(robot, position, speed, command)
    by_hand = 30.0 * (command[:, 0] - position[:, 0]) + 0.3 * (command[:, 1] - speed[:, 0])
    assert made[:, 0] == pytest.approx(by_hand)


def test_the_protocol_of_such_a_robot_has_a_next_experiment(robot):
    rival = {Term("joint_friction", "shoulder", "torque_n_m"): 0.1}
    assert next_experiment(robot, [rival], np.array([0.1, 0.01]))


def test_friction_of_guided_tendons_does_not_depend_on_other_inputs(tmp_path):
    alone = tmp_path / "alone.xml"
    alone.write_text(FINGER)
    beside = tmp_path / "beside.xml"
    pid = '<actuator><pid name="servo" joint="tip" kp="0" kv="0" input="pos vel"/>'
    beside.write_text(FINGER.replace("<actuator>", pid))
    sizes = np.array([0.3, 0.4])
    outcomes = []
    for path in (alone, beside):
        robot = load_robot(path)
        command = np.ones(robot.model.nu)
        outcomes.append(torques(robot, waves(robot, sizes, command), long=0.3, back=0.2))
    assert mujoco.MjModel.from_xml_path(str(beside)).nu == 5
    assert outcomes[1] == pytest.approx(outcomes[0], rel=1e-9)
