"""The gate stays shut as long as the arm can be moving, and no longer."""

import numpy as np

from cablesense_ros.motion_gate import MotionGate
from cablesense_sim.joint_motion import JointMotion, move_duration_s

SPEED, SETTLE = 0.5, 0.2


def gate():
    return MotionGate(np.zeros(2), SPEED, SETTLE)


def test_open_until_a_command_differs():
    watched = gate()
    assert not watched.command(np.zeros(2), 0.0)
    assert not watched.moving(0.0)


def test_shut_for_the_move_and_the_settling():
    watched = gate()
    assert watched.command(np.array([0.0, 0.3]), 10.0)
    end = 10.0 + move_duration_s(0.3, SPEED) + SETTLE
    assert watched.moving(end - 1e-3)
    assert not watched.moving(end + 1e-3)


def test_never_opens_before_the_arm_has_arrived_whatever_the_commands():
    rng = np.random.default_rng(0)
    watched, motion = gate(), JointMotion(np.zeros(2), SPEED)
    for step in range(4000):
        now = step * 0.01
        if rng.random() < 0.02:
            target = rng.uniform(-0.3, 0.3, 2)
            watched.command(target, now)
            motion.go_to(target)
        motion.advance(0.01)
        assert watched.moving(now) or not motion.moving


def test_a_stream_of_small_steps_does_not_add_up():
    watched = gate()
    for k in range(1, 1001):
        watched.command(np.array([0.0, 0.0001 * k]), 0.01 * k)
    assert not watched.moving(10.0 + move_duration_s(0.1, SPEED) + SETTLE + 1e-3)
