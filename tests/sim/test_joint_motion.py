"""Commands are approached smoothly, in time, from any state."""

import numpy as np
import pytest

from cablesense_sim.joint_motion import SHORTEST_MOVE_S, JointMotion, move_duration_s

STEP_S = 1e-3


def path(motion, steps):
    return np.array([motion.advance(STEP_S) for _ in range(steps)])


def test_arrives_in_time_at_the_peak_speed_and_stays():
    motion = JointMotion(np.zeros(2), joint_speed_rad_s=0.5)
    target = np.array([0.4, -0.1])
    motion.go_to(target)
    steps = round(move_duration_s(0.4, 0.5) / STEP_S)
    angles = path(motion, steps + 50)
    speeds = np.abs(np.diff(angles, axis=0)).max() / STEP_S
    assert speeds == pytest.approx(0.5, rel=1e-3)
    np.testing.assert_allclose(angles[steps - 2], target, atol=1e-6)
    np.testing.assert_array_equal(angles[-1], target)
    assert not motion.moving


def test_neither_angle_nor_speed_jumps_when_the_target_changes_on_the_way():
    motion = JointMotion(np.zeros(1), 0.5)
    motion.go_to(np.array([0.3]))
    before = path(motion, 300)
    motion.go_to(np.array([-0.2]))
    after = path(motion, 3000)
    angles = np.concatenate([before, after])[:, 0]
    acceleration = np.diff(angles, 2) / STEP_S**2
    assert np.abs(acceleration).max() < 10.0  # a jump of the speed by 0.1 rad/s would be 100
    np.testing.assert_array_equal(after[-1], [-0.2])


def test_a_stream_of_targets_is_followed():
    motion = JointMotion(np.zeros(1), 0.5)
    for k in range(100):
        motion.go_to(np.array([0.002 * k]))
        path(motion, 10)
    path(motion, round(SHORTEST_MOVE_S / STEP_S) + 200)
    np.testing.assert_allclose(motion.advance(STEP_S), [0.198])


def test_a_long_move_after_a_stream_of_steps_does_not_shoot_beyond_its_target():
    motion = JointMotion(np.zeros(1), np.deg2rad(20.0))
    for k in range(25):
        motion.go_to(np.array([0.02 * (-1) ** k]))
        path(motion, 20)
    motion.go_to(np.array([0.15]))
    angles = path(motion, 3000)
    assert angles.max() < 0.17
    assert angles.min() > -0.05
