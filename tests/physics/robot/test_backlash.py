"""Play between a drive and its joint, planted as teeth that are stiff springs."""

import numpy as np
import pandas as pd
import pytest

from cablesense_gap.robot.amending import changed
from cablesense_gap.robot.model import load_robot
from cablesense_gap.robot.preparation import prepared
from cablesense_gap.robot.recording import read_robot_recording
from cablesense_gap.robot.system import RobotSystem, diagnose
from cablesense_gap.simulator import Term

# kg·m², kg·m², N·m
ROTOR = 0.005
INERTIA = 0.05
WEIGHT = 1.2
PLAY_RAD = 0.02
ARM_M = WEIGHT / 9.81
OWN = INERTIA - ARM_M**2  # of one kilogram
XML = f"""
<mujoco><compiler angle="radian"/><worldbody><body>
  <joint name="hinge" axis="0 1 0" armature="{ROTOR}"/>
  <inertial pos="0 0 {-ARM_M}" mass="1" diaginertia="{OWN} {OWN} {OWN}"/>
</body></worldbody><actuator><motor name="motor" joint="hinge"/></actuator></mujoco>
"""


def run(play_rad):
    """Times, angles and torques of a controlled drive, at 200 Hz; teeth as dead-zone springs."""
    step_s = 2e-4
    stiffness = ROTOR * 1000.0**2
    drive = 0.0
    joint = 0.0
    drive_speed = 0.0
    joint_speed = 0.0
    positions = []
    for k in range(round(24.0 / step_s)):
        t = k * step_s
        asked = 0.8 * np.sin(2.2 * t) + 0.5 * np.sin(4.7 * t + 1.0)
        speed = 1.76 * np.cos(2.2 * t) + 2.35 * np.cos(4.7 * t + 1.0)
        torque = WEIGHT * np.sin(asked) + 20.0 * (asked - drive) + 2.0 * (speed - drive_speed)
        ahead = drive - joint
        pressed = ahead - min(max(ahead, -0.5 * play_rad), 0.5 * play_rad)
        force = stiffness * pressed + 3.0 * (drive_speed - joint_speed) if pressed else 0.0
        drive_speed += step_s * (torque - force) / ROTOR
        joint_speed += step_s * (force - WEIGHT * np.sin(joint)) / INERTIA
        drive += step_s * drive_speed
        joint += step_s * joint_speed
        if k % 25 == 0:
            positions.append((t, drive, torque))
    return np.array(positions[200:])


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    folder = tmp_path_factory.mktemp("backlash")
    rng = np.random.default_rng(0)
    (folder / "hinge.xml").write_text(XML)
    robot = load_robot(folder / "hinge.xml")
    table = run(PLAY_RAD)
    columns = {
        "time_s": table[:, 0],
        "position.hinge": table[:, 1] + rng.normal(0.0, 2e-5, len(table)),
        "torque.hinge": table[:, 2] + rng.normal(0.0, 0.005, len(table)),
        "command.motor": table[:, 2],
    }
    pd.DataFrame(columns).to_csv(folder / "run.csv", index=False)
    return read_robot_recording(folder / "run.csv", robot), robot


@pytest.mark.parametrize("forward", [False, True])
def test_play_shows_in_torques_and_in_motion(recording, forward):
    read, robot = recording
    simulator = RobotSystem(robot, prepared(read, robot, forward=forward), {})
    compared = simulator.comparison
    residuals = []
    for play in (0.0, 0.5 * PLAY_RAD, PLAY_RAD, 2.0 * PLAY_RAD):
        change = changed(robot, [{Term("backlash", "hinge", "play_rad"): play}])
        off = (compared.readings - compared.predicted(change)) / compared.noise
        residuals.append(np.sqrt((off**2).mean()))
    assert residuals[2] == min(residuals)
    assert residuals[2] < 0.35 * residuals[0]


@pytest.mark.slow
def test_play_is_found_and_sized(recording):
    read, robot = recording
    verdict = diagnose(read, robot).verdict
    assert verdict.effects == ("backlash",)
    assert verdict.parameters["backlash.play_rad"].value == pytest.approx(PLAY_RAD, rel=0.1)
