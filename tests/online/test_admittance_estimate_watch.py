"""Whether the estimator's states can be relied on, and what they say then.

Messages of the estimator that break the contract are refused by name.
"""

import math

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped

from cablesense_msgs_py.messages import ForceState
from cablesense_msgs_py.topics import ContractError, Frames
from cablesense_online.admittance.estimate_watch import (
    ContactState,
    EstimateWatch,
    ForcePairs,
    read_wrench,
)
from cablesense_online.admittance.law import AdmittanceSettings

SETTINGS = AdmittanceSettings(stale_after_s=0.2, resume_after_s=1.0, settle_s=0.5)


class Estimator:
    """Plays 100 Hz of states."""

    def __init__(self):
        self.now_s = 100.0
        self.watch = EstimateWatch(SETTINGS, self.now_s)

    def publishes(self, seconds, force=ForceState.FREE, age_s=0.001):
        states = []
        for _ in range(round(100 * seconds)):
            self.now_s += 0.01
            self.watch.received(force, age_s, self.now_s)
            states.append(self.watch.update(self.now_s))
        return states

    def silence(self, seconds):
        states = []
        for _ in range(round(100 * seconds)):
            self.now_s += 0.01
            states.append(self.watch.update(self.now_s))
        return states


@pytest.fixture
def estimator():
    playing = Estimator()
    playing.publishes(1.5)
    return playing


def test_estimates_must_come_for_a_while_before_they_are_trusted():
    states = Estimator().publishes(1.5)
    assert states[80] is ContactState.STOPPED
    assert states[-1] is ContactState.FREE


def test_a_contact_is_known_at_once(estimator):
    assert estimator.publishes(0.01, ForceState.CONTACT)[-1] is ContactState.CONTACT
    assert estimator.publishes(0.01)[-1] is ContactState.FREE


@pytest.mark.parametrize("force", [ForceState.MOVING, ForceState.HIDDEN])
def test_what_is_hidden_or_in_motion_is_unknown_and_no_fault(estimator, force):
    assert set(estimator.publishes(5.0, force)) == {ContactState.UNKNOWN}
    assert estimator.publishes(0.01)[-1] is ContactState.FREE


@pytest.mark.parametrize(
    "force",
    [state for state in ForceState if not state.known and state.value not in ("moving", "hidden")],
)
def test_a_force_that_stays_unknown_for_another_reason_stops(estimator, force):
    states = estimator.publishes(0.3, force)
    assert states[0] is ContactState.UNKNOWN
    assert states[-1] is ContactState.STOPPED
    assert force.value in estimator.watch.reason
    assert estimator.publishes(0.9)[-1] is ContactState.STOPPED
    assert estimator.publishes(0.2)[-1] is ContactState.FREE


def test_silence_stops_within_the_limit_and_estimates_resume(estimator):
    states = estimator.silence(0.3)
    assert states[18] is not ContactState.STOPPED
    assert states[21] is ContactState.STOPPED
    assert "fresh stamp" in estimator.watch.reason
    assert not estimator.watch.publishing(estimator.now_s)
    assert estimator.publishes(0.9)[-1] is ContactState.STOPPED
    assert estimator.publishes(0.2)[-1] is ContactState.FREE


def test_old_stamps_are_silence(estimator):
    assert estimator.publishes(0.3, age_s=0.25)[-1] is ContactState.STOPPED


def test_a_refused_message_stops(estimator):
    estimator.watch.refused("a wrench was refused: nan")
    assert estimator.publishes(0.01)[-1] is ContactState.STOPPED
    assert "nan" in estimator.watch.reason
    assert estimator.publishes(1.2)[-1] is ContactState.FREE


def test_forces_and_states_meet_in_any_order():
    pairs, push = ForcePairs(), np.array([0.0, 5.0, 0.0])
    assert not pairs.force(1, 3, push)
    assert pairs.take(1) == (3, push)
    assert pairs.take(2) is None
    assert pairs.take(3) is None
    assert pairs.force(2, 4, push)
    assert pairs.take(2) == (4, push)
    assert pairs.force(3, 4, push)
    for stamp in range(10, 200):
        assert not pairs.force(stamp, 1, push)
        assert pairs.take(1000 + stamp) is None
    assert pairs.take(10) is None  # what never meets is forgotten


rclpy = pytest.importorskip("rclpy")


pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")
FRAMES = Frames(4, "left/")


def wrench(frame, y=0.0, z=0.0):
    message = WrenchStamped()
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = 7, 5
    message.wrench.force.y, message.wrench.force.z = y, z
    return message


def test_a_contact_and_no_contact_are_read():
    segment, force_n, stamp_ns = read_wrench(wrench("left/segment_3", 3.0, -4.0), FRAMES)
    assert (segment, stamp_ns) == (3, 7_000_000_005)
    assert np.array_equal(force_n, [0.0, 3.0, -4.0])
    for nothing in (0.0, math.nan):
        unknown = wrench("left/base_link", nothing, nothing)
        unknown.wrench.force.x = nothing
        segment, force_n, _ = read_wrench(unknown, FRAMES)
        assert (segment, force_n.any()) == (0, False)


@pytest.mark.parametrize(
    ("message", "complaint"),
    [
        (wrench("left/segment_3", math.nan), "finite"),
        (wrench("left/segment_3", math.inf), "finite"),
        (wrench("left/segment_3", 3000.0), "2000"),
        (wrench("left/segment_9", 3.0), "segment_1"),
        (wrench("segment_3", 3.0), "left/segment_1"),
        (wrench("map"), "left/segment_1"),
        (wrench("left/base_link", 3.0), "segment's frame"),
    ],
)
def test_what_breaks_the_contract_is_refused(message, complaint):
    with pytest.raises(ContractError, match=complaint):
        read_wrench(message, FRAMES)
