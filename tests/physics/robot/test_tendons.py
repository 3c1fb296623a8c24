"""Friction of tendons over guides: the law in closed form, and two ways that agree."""

import mujoco
import numpy as np
import pytest

from cablesense_gap.robot.amending import changed
from cablesense_gap.robot.inverse import InverseDynamics
from cablesense_gap.robot.model import load_robot
from cablesense_gap.robot.motion import Trajectory
from cablesense_gap.simulator import Term

MU = 0.3
TURN = np.deg2rad(70.0)
SLIDE = f"""
<mujoco><option gravity="9.81 0 0"/><worldbody>
  <site name="motor" pos="{-0.2 * np.cos(TURN)} 0 {-0.2 * np.sin(TURN)}"/><site name="guide"/>
  <body><joint name="slide" type="slide" axis="1 0 0"/>
    <inertial pos="0.3 0 0" mass="2" diaginertia="0.001 0.001 0.001"/>
    <site name="hook" pos="0.3 0 0"/></body>
</worldbody><tendon><spatial name="cable">
  <site site="motor"/><site site="guide"/><site site="hook"/>
</spatial></tendon><actuator><motor name="pull" tendon="cable" gear="-1"/></actuator></mujoco>
"""
FINGER = """
<mujoco><compiler angle="radian"/><worldbody>
  <site name="m1" pos="-0.05 0 0.01"/><site name="m2" pos="-0.05 0 -0.012"/>
  <site name="b1" pos="-0.01 0.002 0.011"/><site name="b2" pos="-0.01 0 -0.012"/>
  <body name="near"><joint name="base" axis="0 1 0"/>
    <inertial pos="0.02 0 0" mass="0.05" diaginertia="1e-5 1e-5 1e-5"/>
    <site name="n1" pos="0.008 0 0.011"/><site name="n2" pos="0.01 0 -0.009"/>
    <geom name="roll" type="cylinder" size="0.006 0.02" pos="0.045 0 0" euler="1.5708 0 0"/>
    <site name="side" pos="0.045 0 0.02"/>
    <body name="far" pos="0.045 0 0"><joint name="tip" axis="0 1 0"/>
      <inertial pos="0.015 0 0" mass="0.03" diaginertia="5e-6 5e-6 5e-6"/>
      <site name="f1" pos="0.02 0 0.003"/></body></body>
</worldbody><tendon>
  <spatial name="long"><site site="m1"/><site site="b1"/><site site="n1"/>
    <geom geom="roll" sidesite="side"/><site site="f1"/></spatial>
  <spatial name="back"><site site="n2"/><site site="b2"/><site site="m2"/></spatial>
  <spatial name="free"><site site="m1"/><site site="n1"/></spatial>
</tendon><actuator><motor name="long" tendon="long" gear="-1"/>
  <motor name="back" tendon="back" gear="-2"/>
  <motor name="free" tendon="free"/></actuator></mujoco>
"""


def written(folder, xml):
    (folder / "robot.xml").write_text(xml)
    return load_robot(folder / "robot.xml")


def waves(robot, sizes, command=np.nan):
    """A motion by sines of each joint, (T, J)."""
    time_s = np.arange(0.0, 4.0, 0.005)
    speed = np.arange(2.0, 2.0 + len(sizes))
    phase = time_s[:, None] * speed
    return Trajectory(
        time_s=time_s,
        trial=np.zeros(len(time_s), dtype=int),
        position=sizes * np.sin(phase),
        speed=sizes * speed * np.cos(phase),
        acceleration=-sizes * speed**2 * np.sin(phase),
        direction=np.sign(np.cos(phase)),
        load=np.zeros((len(time_s), len(sizes))),
        command=np.broadcast_to(command, (len(time_s), robot.model.nu)),
    )


def torques(robot, motion, **coefficients):
    values = {Term("capstan_friction", k, "coefficient"): mu for k, mu in coefficients.items()}
    return InverseDynamics(robot, motion).torques(changed(robot, [values]))


def test_one_guide_parts_tensions_by_its_angle(tmp_path):
    robot = written(tmp_path, SLIDE)
    motion = waves(robot, np.array([0.05]))
    needed, given = (torques(robot, motion, cable=mu)[:, 0] for mu in (0.0, MU))
    slides = np.abs(motion.position[:, 0]) < 0.9 * motion.position.max()
    slides[:200] = False  # at first it gives
    way = np.sign(motion.speed[slides, 0]) * np.sign(needed[slides])
    assert given[slides] == pytest.approx(needed[slides] * np.exp(way * MU * TURN), rel=1e-6)


def test_a_tendon_takes_of_every_joint_beyond_its_guides_by_virtual_work(tmp_path):
    robot = written(tmp_path, FINGER)
    pulls = np.array([7.0, 3.0, -2.0])
    assert robot.tendons == ("long", "back")
    motion = waves(robot, np.array([0.3, 0.35]), pulls)
    lost = torques(robot, motion, long=MU) - torques(robot, motion)
    model = robot.model
    data = mujoco.MjData(robot.model)
    for row in range(40, len(lost), 97):
        pieces = []
        turns = []
        for j, off in ((0, 0.0), (0, 1e-6), (0, -1e-6), (1, 1e-6), (1, -1e-6)):
            data.qpos[:] = motion.position[row]
            data.qpos[j] += off
            mujoco.mj_forward(model, data)
            points = data.wrap_xpos.reshape(-1, 3)[: data.ten_wrapnum[0]]
            steps = np.diff(points, axis=0)
            pieces.append(np.linalg.norm(steps, axis=1))
            ways = steps / pieces[-1][:, None]
            turns.append(np.arccos(np.clip((ways[1:] * ways[:-1]).sum(1), -1.0, 1.0)))
        if len(pieces[0]) != 5:  # the roll is not met
            continue
        # the roll is of the first link: what lies on it and beyond it grows with the tip
        first_turn = turns[0]
        lengths = np.array(pieces)
        angles = [first_turn[0], first_turn[1], first_turn[2] + first_turn[3]]
        grouped = np.stack([lengths[:, 0], lengths[:, 1], lengths[:, 2], lengths[:, 4]], axis=1)
        grouped[:, 3] += 0.006 * (np.array([t[2] + t[3] for t in turns]))
        by_joint = np.stack([grouped[1] - grouped[2], grouped[3] - grouped[4]], axis=1) / 2e-6
        beyond = np.cumsum(by_joint[:0:-1], axis=0)[::-1] @ motion.speed[row]
        if np.abs(beyond).min() < 1e-3:
            continue
        share_lost = np.exp(MU * np.cumsum(np.sign(beyond) * angles)) - 1.0
        expected = 7.0 * share_lost @ by_joint[1:]
        assert lost[row] == pytest.approx(expected, rel=0.02, abs=2e-5)


def test_tensions_that_are_commanded_and_those_that_torques_need_lose_alike(tmp_path):
    robot = written(tmp_path, FINGER.replace('<motor name="free" tendon="free"/>', ""))
    sizes = np.array([0.3, 0.35])
    coefficients = {"long": MU, "back": 0.5}
    motion = waves(robot, sizes)
    read = torques(robot, motion, **coefficients)
    data = mujoco.MjData(robot.model)
    pulled = np.empty_like(read)
    for row, position in enumerate(motion.position):
        data.qpos[:] = position
        columns = []
        for data.ctrl[:] in np.eye(2):
            mujoco.mj_forward(robot.model, data)
            columns.append(data.qfrc_actuator.copy())
        pulled[row] = np.linalg.solve(np.array(columns).T, read[row])
    again = torques(robot, waves(robot, sizes, pulled), **coefficients)
    alike = np.isclose(again, read, rtol=1e-6, atol=1e-9).all(axis=1)
    assert alike.mean() > 0.8  # before guides slip the one is elastic, the other is not
