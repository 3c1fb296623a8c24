"""The gate is shut as long as the arm can be moving."""

import numpy as np
import pytest

from benchmarks.estimation_settings import estimation_settings
from cablesense_contact.felt_arm import FeltArm
from cablesense_msgs_py.messages import ForceState, Level
from cablesense_online.answer import Answer
from cablesense_online.contact_estimator import ContactEstimator, EstimationState, Sample
from cablesense_online.motion import MotionGate
from cablesense_online.statuses import SampleCounts, motion_status
from cablesense_online.tare import UnloadedState
from cablesense_sim.arm import open_arm
from cablesense_sim.joint_motion import JointMotion

ARM = open_arm("cdsm")
SPEED = 0.5
SETTLE = 0.2
S = 1_000_000_000
MS = 1_000_000


class NoContacts:
    """Finds none; here nobody asks."""


class Gate:
    """Its samples arrive at once, by a monotonic clock that goes with the stamps' steps or not."""

    def __init__(self, still_rad=0.0, follow_rad_s=0.0):
        waits = {"joint_speed_rad_s": SPEED, "settle_s": SETTLE}
        follow = {"still_rad": still_rad, "follow_rad_s": follow_rad_s}
        self.settings = estimation_settings(**waits, **follow)
        self.rules = MotionGate(self.settings)
        self.motion = self.rules.at_rest(np.zeros(2))

    def command(self, command_rad):
        """Whether it is another command than the last one."""
        if np.array_equal(command_rad, self.motion.command_rad):
            return False
        self.motion = self.rules.commanded(self.motion, command_rad)
        return True

    def moving(self, stamp_ns, now_ns=None, now_s=None):
        now_ns = stamp_ns if now_ns is None else now_ns
        now_s = now_ns * 1e-9 if now_s is None else now_s
        self.motion = self.rules.at_sample(self.motion, stamp_ns, now_ns, now_s)
        return self.motion.shut

    @property
    def turning(self):
        return self.rules.turning(self.motion)


def gate():
    return Gate()


def test_never_opens_before_the_arm_has_arrived_whatever_the_commands():
    rng = np.random.default_rng(0)
    watched = gate()
    motion = JointMotion.at_rest(np.zeros(2), SPEED)
    for step in range(4000):
        if rng.random() < 0.02:
            target = rng.uniform(-0.3, 0.3, 2)
            watched.command(target)
            motion = motion.towards(target)
        motion = motion.after(0.01)
        assert watched.moving(10 * MS * step) or not motion.moving


def test_stamps_that_step_back_keep_what_is_left_to_wait():
    watched = gate()
    watched.command(np.array([0.0, 0.3]))
    watched.moving(3600 * S, now_s=0.0)
    remaining_ns = watched.motion.rest_from_ns - 3600 * S
    assert watched.moving(5 * S, now_s=0.0)
    assert watched.motion.stepped == -1
    assert watched.moving(5 * S + remaining_ns - MS, now_s=remaining_ns * 1e-9 - 1e-3)
    assert not watched.moving(5 * S + remaining_ns, now_s=remaining_ns * 1e-9)


def test_stamps_that_step_forward_do_not_end_the_wait():
    watched = gate()
    watched.command(np.array([0.0, 0.3]))
    watched.moving(0, now_s=100.0)
    wait_s = watched.motion.rest_from_ns * 1e-9
    assert watched.moving(3600 * S, now_s=100.5)
    assert watched.motion.stepped == 1
    assert watched.motion.rest_from_ns == pytest.approx(3600 * S + (wait_s - 0.5) * S, abs=MS)
    assert watched.moving(round((3600.0 + wait_s - 0.5) * S) - MS, now_s=99.999 + wait_s)
    assert watched.motion.stepped == 0
    assert not watched.moving(round((3600.0 + wait_s - 0.5) * S), now_s=100.0 + wait_s)


STILL = 1e-4
FOLLOW = 0.05


def test_noise_of_a_stream_of_commands_is_no_motion():
    rng = np.random.default_rng(0)
    watched = Gate(STILL)
    for step in range(200):
        watched.command(rng.uniform(-STILL, STILL, 2))
        assert not watched.moving(10 * MS * step)
    np.testing.assert_array_equal(watched.motion.pose_rad, np.zeros(2))
    watched.command(np.array([0.0, 2.1 * STILL]))
    assert watched.moving(10 * MS * 200)


def test_a_slow_motion_is_followed_along_the_set_points_and_ends_at_the_command():
    watched = Gate(STILL, FOLLOW)
    motion = JointMotion.at_rest(np.zeros(2), SPEED)
    for step in range(400):
        target = np.array([0.0, min(0.8 * FOLLOW * 0.01 * step, 0.1)])
        changed = watched.command(target)
        motion = motion.after(0.01)
        if changed:
            motion = motion.towards(target)
        assert not watched.moving(10 * MS * step)
        np.testing.assert_allclose(watched.motion.course.angle_rad, motion.angle_rad, atol=1e-12)
        assert np.abs(watched.motion.pose_rad - watched.motion.course.angle_rad).max() < 2.1e-3
        assert watched.turning or not 10 < step < 250
    np.testing.assert_array_equal(watched.motion.course.angle_rad, target)
    np.testing.assert_allclose(watched.motion.pose_rad, target, atol=1e-4)
    assert not watched.turning


def test_a_faster_motion_shuts_the_gate_and_is_reported_once_it_lasts():
    watched = Gate(STILL, FOLLOW)
    estimator = ContactEstimator(FeltArm(ARM), NoContacts(), watched.settings)
    counts = SampleCounts(0.0)

    def status_after(step):
        stamp_ns = 10 * MS * step
        moving = watched.moving(stamp_ns)
        answer = Answer(probabilities=() if moving else (1.0, 0.0), stamp_ns=stamp_ns)
        if moving:
            answer = Answer(force=ForceState.MOVING, stamp_ns=stamp_ns)
        counts.count(Sample(b"", stamp_ns, stamp_ns * 1e-9), answer)
        blind_s = counts.blind_s(watched.motion.last_ns)
        state = EstimationState(watched.motion, UnloadedState(None, False, False))
        state = state._replace(is_commanded=True)
        return motion_status(estimator, state, blind_s, pose_range_deg=10.0, refused=0)

    for step in range(400):
        counts.commands += watched.command(
            np.array([0.0, 0.1 * np.sin(4.0 * FOLLOW * 0.1 * step)])
        )
        warned = "2.86479 deg/s (follow_deg_s)" in status_after(step).message
        assert warned == (step > 303)
    for step in range(400, 500):  # what is left of the stream is noise about where it ended
        counts.commands += watched.command(watched.motion.command_rad + 1e-6)
        status = status_after(step)
    assert not watched.motion.shut
    assert status.level is Level.OK


def test_lengths_are_moves_by_what_a_joint_turns_for_them():
    """A joint 2.5 mm from its wire: 0.3 mm is 7 degrees, half a micrometre is a hundredth."""
    settings = Gate(still_rad=np.deg2rad(0.02)).settings
    gate = MotionGate(settings, per_radian=0.0025)
    length_m = np.full(2, 0.07)
    rested = gate.at_sample(gate.at_rest(length_m), 10**9, 10**9, 1.0)
    rested = gate.at_sample(rested, 10**11, 10**11, 100.0)
    assert not rested.shut
    assert not gate.follows(rested, length_m + 3e-4)
    assert gate.follows(rested, length_m + 5e-7)
