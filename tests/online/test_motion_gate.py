"""The gate stays shut as long as the arm can be moving, and no longer."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_online.motion_gate import MotionGate
from cablesense_sim.joint_motion import JointMotion, move_duration_s

SPEED, SETTLE = 0.5, 0.2
S = 1_000_000_000
MS = 1_000_000


def gate():
    return MotionGate(np.zeros(2), SPEED, SETTLE)


def test_open_until_a_command_differs():
    watched = gate()
    assert not watched.command(np.zeros(2))
    assert not watched.moving(0)


def test_shut_for_the_move_and_the_settling_from_the_next_sample_on():
    watched = gate()
    watched.moving(3 * S)
    assert watched.command(np.array([0.0, 0.3]))
    assert watched.shut
    assert watched.moving(10 * S)
    end = 10 * S + round((move_duration_s(0.3, SPEED) + SETTLE) * S)
    assert watched.rest_from_ns == end
    assert watched.moving(end - 1)
    assert not watched.moving(end)
    assert not watched.shut


def test_never_opens_before_the_arm_has_arrived_whatever_the_commands():
    rng = np.random.default_rng(0)
    watched, motion = gate(), JointMotion(np.zeros(2), SPEED)
    for step in range(4000):
        if rng.random() < 0.02:
            target = rng.uniform(-0.3, 0.3, 2)
            watched.command(target)
            motion.go_to(target)
        motion.advance(0.01)
        assert watched.moving(10 * MS * step) or not motion.moving


def test_a_stream_of_small_steps_does_not_add_up():
    watched = gate()
    for k in range(1, 1001):
        watched.command(np.array([0.0, 0.0001 * k]))
        watched.moving(10 * MS * k)
    assert not watched.moving(10 * S + round((move_duration_s(0.1, SPEED) + SETTLE) * S) + MS)


def test_stamps_that_step_back_keep_what_is_left_to_wait():
    watched = gate()
    watched.command(np.array([0.0, 0.3]))
    watched.moving(3600 * S)
    left = watched.rest_from_ns - 3600 * S
    assert watched.moving(5 * S)
    assert watched.moving(5 * S + left - MS)
    assert not watched.moving(5 * S + left)


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(0, 160))
def test_a_gate_restored_anywhere_answers_the_same(seed, restored_at):
    rng = np.random.default_rng(seed)
    watched, other = gate(), None
    for step in range(200):
        if rng.random() < 0.05:
            target = rng.uniform(-0.3, 0.3, 2)
            watched.command(target)
            if other is not None:
                other.command(target)
        moving = watched.moving(10 * MS * step)
        if other is not None:
            assert other.moving(10 * MS * step) == moving
            assert other.rest_from_ns == watched.rest_from_ns
        if step == restored_at:
            other = gate()
            state = (watched.command_rad, watched.lowest_rad, watched.highest_rad)
            other.restore(*state, watched.rest_from_ns)
            other.moving(10 * MS * step)
