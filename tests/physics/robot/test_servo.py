"""Robots under position servos whose positions a camera reads: from commands to joints."""

import mujoco
import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from cablesense_gap.robot.amending import amended_xml
from cablesense_gap.robot.inverse import Servos
from cablesense_gap.robot.model import load_robot
from cablesense_gap.robot.recording import read_robot_recording
from cablesense_gap.robot.system import diagnose
from cablesense_gap.simulator import Term
from cablesense_gap.verdict import read_verdict
from cablesense_recording.recording import RecordingError
from cablesense_ros.cli.app import app
from tests.helpers.two_link import JOINTS, XML, motion, torques

STIFFNESS = 40.0
"""Of the servos, N·m/rad."""


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "servos.xml"
    path.write_text(XML.replace("<motor ", f'<position kp="{STIFFNESS}" '))
    return path


def seen(path, zero=(0.0, 0.0), into_elbow=0.0, play=(0.0, 0.0), payload=0.0, gain=1.0, seed=1):
    """A recording by a camera that is good to half a milliradian; torques by the textbook."""
    rng = np.random.default_rng(seed)
    tables = []
    for trial in range(6):
        time_s, joint, speed, acceleration = motion(rng)
        joint[:, 0] += 0.5 * np.pi  # about hanging, so that torques change their signs
        torque = torques(joint, speed, acceleration, payload=payload)
        drive = joint + 0.5 * np.array(play) * np.sign(torque)
        drive[:, 1] -= into_elbow * drive[:, 0]
        at_drive = torque.copy()
        at_drive[:, 0] += into_elbow * torque[:, 1]
        command = drive + at_drive / (STIFFNESS * np.array([1.0, gain]))
        read = joint + zero + rng.normal(0.0, 5e-4, joint.shape)
        columns = {"time_s": time_s + 10.0 * trial, "trial": trial}
        for j, name in enumerate(JOINTS):
            columns |= {f"position.{name}": read[:, j], f"command.{name}": command[:, j]}
        tables.append(pd.DataFrame(columns))
    pd.concat(tables).to_csv(path, index=False)
    return path


def test_a_servo_yields_as_mujoco_lets_it(tmp_path):
    path = tmp_path / "geared.xml"
    position = '<position kp="30" kv="0.3" gear="1.5" '
    path.write_text(XML.replace("<motor ", position))
    robot = load_robot(path)
    commands = np.array([0.6, -0.4])
    data = mujoco.MjData(robot.model)
    data.ctrl[:] = commands
    for _ in range(20_000):
        mujoco.mj_step(robot.model, data)
    assert np.abs(data.qvel).max() < 1e-6
    servos = Servos.of(robot)
    yields = data.qfrc_bias / servos.stiffness
    expected = servos.per_command * commands + servos.offset - yields
    assert data.qpos == pytest.approx(expected, abs=1e-6)
    assert np.abs(yields).max() > 0.01


def test_the_amended_model_has_the_gain_and_holds_the_same_commands(model, tmp_path):
    robot = load_robot(model)
    amended = tmp_path / "amended.xml"
    amended.write_text(amended_xml(robot, {Term("servo_gain", "elbow", "share"): 0.5}))
    servos = Servos.of(load_robot(amended))
    assert servos.stiffness == pytest.approx([STIFFNESS, 1.5 * STIFFNESS])
    assert servos.per_command == pytest.approx(Servos.of(robot).per_command)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("planted", "effect", "place", "number", "value"),
    [
        ({"zero": (0.0, 0.18)}, "joint_zero", "elbow", "zero_rad", 0.18),
        ({"into_elbow": 0.1}, "joint_coupling", "shoulder", "share", 0.1),
        ({"payload": 0.3}, "payload", "lower", "mass_kg", 0.3),
        ({"gain": 0.5}, "servo_gain", "elbow", "share", -0.5),
    ],
    ids=["zero", "coupling", "payload", "gain"],
)
def test_what_is_between_command_and_joint_is_named_and_sized(
    planted, effect, place, number, value, model, tmp_path
):
    robot = load_robot(model)
    recording = read_robot_recording(seen(tmp_path / "seen.csv", **planted), robot)
    verdict = diagnose(recording, robot, external=True).verdict
    assert verdict.effects == (effect,)
    assert verdict.probability > 0.5
    assert place in (*verdict.where.joints, *verdict.where.bodies)
    (number_found,) = (n for name, n in verdict.parameters.items() if name.endswith(number))
    assert number_found.value == pytest.approx(value, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(("play", "effect"), [(0.0, "none"), (0.05, "backlash")])
def test_play_is_told_from_a_robot_that_follows_its_commands(play, effect, model, tmp_path):
    robot = load_robot(model)
    recording = read_robot_recording(seen(tmp_path / "seen.csv", play=(play, 0.0)), robot)
    assert diagnose(recording, robot, external=True).verdict.effects == (effect,)


def test_the_command_asks_for_servos_and_predicts_what_a_camera_sees(model, tmp_path):
    recording = str(seen(tmp_path / "seen.csv", zero=(0.0, 0.18)))
    asked = ["gap", "diagnose", recording, "--positions", "external", "--workers", "1"]
    (tmp_path / "motors.xml").write_text(XML)
    without = [*asked, "--model", str(tmp_path / "motors.xml"), "--out", "none"]
    with pytest.raises(RecordingError, match="shoulder, elbow without a position servo"):
        CliRunner().invoke(app, without, catch_exceptions=False)
    out = tmp_path / "out"
    ran = CliRunner().invoke(app, [*asked, "--model", str(model), "--out", str(out)])
    assert ran.exit_code == 0, ran.output
    assert read_verdict(out / "verdict.json").effects == ("joint_zero",)
    predicted = str(tmp_path / "predicted.csv")
    words = ["gap", "predict", recording, "--positions", "external", "--model", str(out)]
    ran = CliRunner().invoke(app, [*words, "--out", predicted])
    assert ran.exit_code == 0, ran.output
    table = pd.read_csv(predicted)
    off = table["position.elbow"] - table["predicted.position.elbow"]
    assert np.sqrt((off**2).mean()) < 2e-3
