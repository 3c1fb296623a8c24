"""Messages of the estimator that break the contract are refused by name."""

import math

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
from std_msgs.msg import Float64MultiArray

from cablesense_msgs_py.topics import ContractError, Frames
from cablesense_online.admittance.estimate_watch import (
    check_probabilities,
    input_is_stale,
    read_wrench,
)

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
    felt = read_wrench(wrench("left/segment_3", 3.0, -4.0), FRAMES)
    assert felt.segment == 3
    assert felt.stamp_ns == 7_000_000_005
    assert np.array_equal(felt.force_n, [0.0, 3.0, -4.0])
    assert read_wrench(wrench("left/base_link"), FRAMES).segment == 0


@pytest.mark.parametrize(
    ("message", "words"),
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
def test_what_breaks_the_contract_is_refused(message, words):
    with pytest.raises(ContractError, match=words):
        read_wrench(message, FRAMES)


@pytest.mark.parametrize("data", [[], [0.5, 0.5], [0.2] * 4 + [math.nan], [0.2] * 4 + [-0.1]])
def test_probabilities_that_are_none_are_refused(data):
    with pytest.raises(ContractError, match="5 probabilities"):
        check_probabilities(Float64MultiArray(data=data), 4)
    check_probabilities(Float64MultiArray(data=[0.2] * 5), 4)


def test_only_the_estimators_own_word_on_its_samples_counts():
    def said(name, level):
        return DiagnosticArray(status=[DiagnosticStatus(name=name, level=bytes([level]))])

    assert input_is_stale(said("estimator: cable_tensions", 3), "estimator") is True
    assert input_is_stale(said("estimator: cable_tensions", 2), "estimator") is False
    assert input_is_stale(said("estimator: model", 3), "estimator") is None
    assert input_is_stale(said("other: cable_tensions", 3), "estimator") is None
