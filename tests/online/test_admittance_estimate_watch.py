"""Unknown, free, stale and contact are distinguished, though the wrench is zero in three of them.

Messages of the estimator that break the contract are refused by name.
"""

import math

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
from std_msgs.msg import Float64MultiArray

from cablesense_msgs_py.topics import ContractError, Frames
from cablesense_online.admittance.estimate_watch import (
    ContactState,
    EstimateWatch,
    check_probabilities,
    input_is_stale,
    read_wrench,
)
from cablesense_online.admittance.law import AdmittanceSettings

SETTINGS = AdmittanceSettings(stale_after_s=0.2, resume_after_s=1.0, settle_s=0.5)
REST, MOVED = np.zeros(8), np.full(8, 0.01)


class Estimator:
    """Plays 100 Hz of wrenches, and probabilities beside those that are estimates."""

    def __init__(self):
        self.now_s = 100.0
        self.watch = EstimateWatch(REST, SETTINGS, self.now_s)

    def publishes(self, seconds, contact=False, estimates=True, age_s=0.001):
        states = []
        for _ in range(round(100 * seconds)):
            self.now_s += 0.01
            self.watch.received_wrench(contact, age_s, self.now_s)
            if estimates:
                self.watch.received_probabilities(self.now_s)
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
    assert estimator.publishes(0.02, contact=True)[-1] is ContactState.CONTACT
    assert estimator.publishes(0.5)[-1] is ContactState.FREE


def test_zeros_after_a_command_are_no_estimate_that_the_arm_is_free(estimator):
    estimator.watch.commanded(MOVED, estimator.now_s)
    states = estimator.publishes(0.58, estimates=False)
    assert set(states) == {ContactState.UNKNOWN}
    assert estimator.publishes(0.1)[-1] is ContactState.FREE


def test_an_estimator_that_answers_while_the_arm_moves_is_trusted(estimator):
    estimator.watch.commanded(MOVED, estimator.now_s)
    assert set(estimator.publishes(0.5, contact=True)) == {ContactState.CONTACT}


def test_zeros_for_longer_than_a_move_takes_are_a_fault(estimator):
    estimator.watch.commanded(MOVED, estimator.now_s)
    states = estimator.publishes(0.6 + 0.2 + 0.1, estimates=False)
    assert states[-1] is ContactState.STOPPED
    assert "no estimate" in estimator.watch.reason


def test_silence_stops_within_the_limit_and_estimates_resume(estimator):
    states = estimator.silence(0.3)
    assert states[18] is not ContactState.STOPPED
    assert states[21] is ContactState.STOPPED
    assert "no wrench" in estimator.watch.reason
    assert not estimator.watch.publishing(estimator.now_s)
    assert estimator.publishes(0.9)[-1] is ContactState.STOPPED
    assert estimator.publishes(0.2)[-1] is ContactState.FREE


def test_old_stamps_are_silence(estimator):
    assert estimator.publishes(0.3, age_s=0.25)[-1] is ContactState.STOPPED


def test_the_estimators_report_of_stale_samples_stops_until_estimates_come(estimator):
    estimator.silence(0.05)
    estimator.watch.received_input_state(True, estimator.now_s)
    assert estimator.watch.update(estimator.now_s) is ContactState.STOPPED
    assert "stale" in estimator.watch.reason
    assert estimator.publishes(1.2)[-1] is ContactState.FREE


def test_a_refused_message_stops(estimator):
    estimator.watch.refused("a wrench was refused: nan")
    assert estimator.publishes(0.01)[-1] is ContactState.STOPPED
    assert "nan" in estimator.watch.reason
    assert estimator.publishes(1.2)[-1] is ContactState.FREE


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
    assert read_wrench(wrench("left/base_link"), FRAMES)[0] == 0


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


@pytest.mark.parametrize("data", [[], [0.5, 0.5], [0.2] * 4 + [math.nan], [0.2] * 4 + [-0.1]])
def test_probabilities_that_are_none_are_refused(data):
    with pytest.raises(ContractError, match="5 probabilities"):
        check_probabilities(Float64MultiArray(data=data), 4)
    check_probabilities(Float64MultiArray(data=[0.2] * 5), 4)


def test_only_the_estimators_report_on_its_samples_counts():
    def report(name, level):
        return DiagnosticArray(status=[DiagnosticStatus(name=name, level=bytes([level]))])

    assert input_is_stale(report("estimator: cable_tensions", 3), "estimator") is True
    assert input_is_stale(report("estimator: cable_tensions", 2), "estimator") is False
    assert input_is_stale(report("estimator: model", 3), "estimator") is None
    assert input_is_stale(report("other: cable_tensions", 3), "estimator") is None
