"""Robots compared forward in time: what windows of measured motion tell without torques."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from cablesense_gap.robot.amending import changed
from cablesense_gap.robot.doubts import beyond_range, servos_read
from cablesense_gap.robot.model import load_robot
from cablesense_gap.robot.preparation import prepared
from cablesense_gap.robot.recording import read_robot_recording
from cablesense_gap.robot.system import RobotSystem, diagnose
from cablesense_gap.simulator import Term
from cablesense_recording.recording import RecordingError
from tests.helpers.two_link import recorded, write_model


@pytest.fixture
def robot(tmp_path):
    return load_robot(write_model(tmp_path))


def commanded(tmp_path, robot, **planted):
    """The recording with commands in place of torques."""
    path = recorded(tmp_path / "recording.csv", noise_n_m=0.0, **planted)
    table = pd.read_csv(path)
    table.columns = [name.replace("torque.", "command.") for name in table]
    table.to_csv(path, index=False)
    return read_robot_recording(path, robot)


def compared(recording, robot, forward=None):
    return RobotSystem(robot, prepared(recording, robot, forward=forward), {}).comparison


def test_without_torques_the_way_is_forward_and_the_closed_form_moves_alike(tmp_path, robot):
    motion = compared(commanded(tmp_path, robot), robot)
    assert "forward in time" in motion.description
    assert motion.names == (
        "position.shoulder",
        "position.elbow",
        "velocity.shoulder",
        "velocity.elbow",
    )
    floors = (motion.readings - motion.predicted(robot.nominal())) / motion.floor
    assert np.sqrt((floors**2).mean()) < 2.0
    assert (np.sqrt((motion.readings**2).mean(0)) > 4.0 * motion.floor).all()


def test_a_window_adds_to_coasting_what_force_by_mass_makes_of_it(tmp_path):
    path = tmp_path / "slide.xml"
    mass = 2.0
    force = 0.5
    path.write_text(
        "<mujoco><worldbody><body><joint name='x' type='slide' axis='1 0 0'/>"
        f"<geom size='0.1' mass='{mass}'/></body></worldbody>"
        "<actuator><motor name='pull' joint='x'/></actuator></mujoco>"
    )
    slide = load_robot(path)
    time_s = np.arange(0.0, 12.0, 0.01)
    wave = np.sin(2.0 * np.pi * 0.5 * time_s)
    table = {"time_s": time_s, "position.x": wave, "command.pull": -mass * np.pi**2 * wave}
    pd.DataFrame(table).to_csv(tmp_path / "slide.csv", index=False)
    motion = compared(read_robot_recording(tmp_path / "slide.csv", slide), slide)
    as_asked = motion.predicted(slide.nominal())
    assert as_asked == pytest.approx(motion.readings, abs=0.01 * np.abs(motion.readings).max())
    less = changed(slide, [{Term("torque_offset", "x", "torque_n_m"): force}])  # read, not given
    gone = as_asked - motion.predicted(less)
    over_s = motion.span_s
    expected = np.tile([0.5 * force / mass * over_s**2, force / mass * over_s], (len(gone), 1))
    assert gone == pytest.approx(expected, rel=1e-3)


def servo(tmp_path, kp):
    """A slide whose servo follows a slow wave, at 4 Hz, and its recording."""
    path = tmp_path / "servo.xml"
    time_s = np.arange(0.0, 200.0, 0.25)
    path.write_text(
        "<mujoco><worldbody><body><joint name='x' type='slide' axis='1 0 0' damping='200'/>"
        "<geom size='0.1' mass='2'/></body></worldbody>"
        f"<actuator><position name='servo' joint='x' kp='{kp}'/></actuator></mujoco>"
    )
    slide = load_robot(path)
    wave = 0.2 * np.sin(0.4 * time_s)
    table = {
        "time_s": time_s,
        "position.x": wave,
        "command.servo": wave + 0.01 * np.cos(0.4 * time_s),
    }
    pd.DataFrame(table).to_csv(tmp_path / "servo.csv", index=False)
    return slide, read_robot_recording(tmp_path / "servo.csv", slide)


def test_the_floor_of_a_stiff_servo_is_what_its_stiffness_allows(tmp_path):
    kp = 2e4
    slide, recording = servo(tmp_path, kp)
    motion = prepared(recording, slide)
    comparison = RobotSystem(slide, motion, {}).comparison
    assert comparison.span_s > 1.0
    assert comparison.floor[0] == pytest.approx(0.005 * motion.scale.torque[0] / kp, rel=0.1)
    (said,) = servos_read(slide, motion)
    assert "servos servo are taken to act on the recorded positions" in said
    assert not servos_read(slide, replace(motion, forward=False))


@pytest.mark.parametrize(
    ("term", "value", "reading"),
    [
        (
            Term("joint_zero", "elbow", "zero_rad"),
            0.05,
            lambda angle: angle + np.array([0.0, 0.05]),
        ),
        (Term("encoder_scale", "shoulder", "share"), 0.1, lambda angle: angle * [1.1, 1.0]),
        (
            Term("joint_coupling", "shoulder_into_elbow", "share"),
            0.2,
            lambda angle: angle - 0.2 * angle[:, [0]] * [0.0, 1.0],
        ),
    ],
)
def test_what_encoders_read_otherwise_is_told_by_that_effect(
    tmp_path, robot, term, value, reading
):
    recording = commanded(tmp_path, robot)
    command = recording.command
    if term.effect == "joint_coupling":  # the shoulder's drive bears the elbow's torque too
        command = command + 0.2 * command[:, [1]] * [1.0, 0.0]
    motion = compared(
        replace(recording, position=reading(recording.position), command=command), robot
    )
    nominal, other = (
        np.sqrt(
            np.mean(
                ((motion.readings - motion.predicted(changed(robot, [v]))) / motion.floor) ** 2
            )
        )
        for v in ({}, {term: value})
    )
    assert other < 1.5
    assert nominal > 5.0


@pytest.mark.slow  # a whole search, of many courses through time
def test_a_rotor_is_found_and_sized_without_torques(tmp_path, robot):
    recording = commanded(tmp_path, robot, armature=(0.0, 0.01), trials=2)
    verdict = diagnose(recording, robot).verdict
    assert verdict.effects == ("rotor_inertia",)
    assert verdict.where.joints == ("elbow",)
    size = verdict.parameters["rotor_inertia.inertia_kg_m2"]
    assert size.value == pytest.approx(0.01, rel=0.1)
    assert verdict.compared.startswith("Compared forward in time")
    assert verdict.channels["velocity.elbow"].unit == "rad/s"


def test_commands_that_the_model_clips_are_told(tmp_path, robot):
    path = tmp_path / "clipped.xml"
    text = robot.path.read_text().replace(
        'joint="elbow"/>', 'joint="elbow" ctrlrange="-0.1 0.1"/>'
    )
    path.write_text(text)
    clipped = load_robot(path)
    (said,) = beyond_range(commanded(tmp_path, clipped), clipped)
    assert "command.elbow goes from" in said
    assert said.endswith("clips to its range of -0.1 to 0.1.")


def test_actuators_with_a_state_need_torques(tmp_path, robot):
    path = tmp_path / "lagging.xml"
    path.write_text(
        robot.path.read_text().replace(
            '<motor name="elbow" joint="elbow"/>',
            '<general name="elbow" joint="elbow" dyntype="filter" dynprm="0.1"/>',
        )
    )
    lagging = load_robot(path)
    with pytest.raises(RecordingError, match="have an internal state"):
        prepared(commanded(tmp_path, lagging), lagging)
