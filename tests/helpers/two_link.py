"""A two-link pendulum of our own, and recordings of it with something planted."""

from pathlib import Path

import mujoco
import numpy as np
import pandas as pd

XML = """
<mujoco model="two_link">
  <compiler angle="radian"/>
  <worldbody>
    <body name="upper">
      <joint name="shoulder" axis="0 1 0"/>
      <inertial pos="0.15 0 0" mass="0.6" diaginertia="0.0005 0.005 0.005"/>
      <body name="lower" pos="0.3 0 0">
        <joint name="elbow" axis="0 1 0"/>
        <inertial pos="0.1 0 0" mass="0.5" diaginertia="0.0003 0.002 0.002"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="shoulder" joint="shoulder"/>
    <motor name="elbow" joint="elbow"/>
  </actuator>
</mujoco>
"""
JOINTS = ("shoulder", "elbow")
RATE_HZ = 100.0


def write_model(folder):
    """The nominal model's file."""
    path = Path(folder) / "robot.xml"
    path.write_text(XML)
    return path


def torques(position, speed, acceleration, friction=(0.0, 0.0), armature=(0.0, 0.0), payload=0.0):
    """(T, 2) from the textbook's closed form; `payload` hangs at the end of the lower link.

    Spong, Hutchinson and Vidyasagar, Robot Modeling and Control, 2006, section 7.4.
    """
    m1 = 0.6
    m2 = 0.5
    l1 = 0.3
    c1 = 0.15
    i1 = 0.005
    i2 = 0.002
    first = m2 * 0.1 + payload * 0.2
    second = m2 * 0.1**2 + i2 + payload * 0.2**2
    mass = m2 + payload
    cos = np.cos(position[:, 1])
    sin = np.sin(position[:, 1])
    h = l1 * first * sin
    m11 = m1 * c1**2 + i1 + mass * l1**2 + second + 2.0 * l1 * first * cos
    m12 = second + l1 * first * cos
    v1, v2 = speed.T
    a1, a2 = acceleration.T
    # both links point along x at zero and turn about y, downwards
    g1 = -9.81 * (m1 * c1 + mass * l1) * np.cos(position[:, 0])
    g2 = -9.81 * first * np.cos(position.sum(1))
    torque = np.stack(
        [
            m11 * a1 + m12 * a2 - h * (2.0 * v1 * v2 + v2**2) + g1 + g2,
            m12 * a1 + second * a2 + h * v1**2 + g2,
        ],
        axis=1,
    )
    return torque + np.array(friction) * np.sign(speed) + np.array(armature) * acceleration


def motion(rng, seconds=4.0, home=(0.0, 0.0)):
    """Times, positions, speeds and accelerations of a sum of sines about a pose."""
    time_s = np.arange(0.0, seconds, 1.0 / RATE_HZ)
    course = np.zeros((3, len(time_s), 2))
    for joint in range(2):
        for hertz in (0.2, 0.5, 0.9):
            size = rng.uniform(0.1, 0.4) / hertz
            w = 2.0 * np.pi * hertz * rng.uniform(0.8, 1.2)
            phase = w * time_s + rng.uniform(0.0, 6.0)
            course[:, :, joint] += (
                0.3 * size * np.array([np.sin(phase), w * np.cos(phase), -w * w * np.sin(phase)])
            )
    course[0] += home
    return time_s, *course


def recorded(
    path, seed=0, trials=4, read=lambda torque: torque, noise_n_m=0.01, home=(0.0, 0.0), **planted
):
    """A CSV of the pendulum with encoders of 0.1 mrad."""
    rng = np.random.default_rng(seed)
    tables = []
    for trial in range(trials):
        time_s, position, speed, acceleration = motion(rng, home=home)
        torque = read(torques(position, speed, acceleration, **planted))
        columns = {"time_s": time_s + 10.0 * trial, "trial": trial}
        for j, joint in enumerate(JOINTS):
            columns[f"position.{joint}"] = np.round(position[:, j] * 1e4) / 1e4
            columns[f"velocity.{joint}"] = speed[:, j]
            columns[f"torque.{joint}"] = torque[:, j] + rng.normal(0.0, noise_n_m, len(time_s))
        tables.append(pd.DataFrame(columns))
    pd.concat(tables).to_csv(path, index=False)
    return path


def worn(path, seed, zero_rad=0.0, gain=1.0, trials=3, **planted):
    """A recording of a pendulum with a cable harness, and bearings that are rough in places.

    At the shoulder an encoder's zero and a torque's scale may be off.
    """
    recorded(path, seed=seed, trials=trials, **planted)
    table = pd.read_csv(path)
    for joint, size in zip(JOINTS, (0.3, 0.1), strict=True):
        position = table[f"position.{joint}"]
        speed = table[f"velocity.{joint}"]
        harness = 2.0 * (position - 0.1) + 6.0 * (position - 0.1) ** 3 + np.sin(11.0 * position)
        rough = (1.0 + np.sin(5.0 * position)) * np.sign(speed)
        table[f"torque.{joint}"] += size * (harness + 0.5 * rough)
    table["position.shoulder"] += zero_rad
    table["torque.shoulder"] *= gain
    table.to_csv(path, index=False)
    return path


def model_torques(position, speed, acceleration):
    """(T, 2) by MuJoCo, of the nominal model."""
    model = mujoco.MjModel.from_xml_string(XML)
    data = mujoco.MjData(model)
    torque = np.empty_like(position)
    for k in range(len(position)):
        data.qpos[:] = position[k]
        data.qvel[:] = speed[k]
        data.qacc[:] = acceleration[k]
        mujoco.mj_inverse(model, data)
        torque[k] = data.qfrc_inverse
    return torque
