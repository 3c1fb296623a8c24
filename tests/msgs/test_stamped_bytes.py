"""Stamps of serialized messages, read and replaced without touching another byte."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_msgs_py.serialized import restamped, stamp_ns
from cablesense_msgs_py.topics import ContractError

STAMPS = st.integers(0, 2**31 * 10**9 - 1)


@given(STAMPS, STAMPS, st.sampled_from([b"\0\0", b"\0\1"]), st.binary(max_size=50))
def test_another_stamp_and_the_same_rest(old, new, order, rest):
    raw = restamped(order + bytes(10), old) + rest
    assert stamp_ns(raw) == old
    moved = restamped(raw, new)
    assert stamp_ns(moved) == new
    assert moved[:4] + moved[12:] == raw[:4] + raw[12:]
    assert restamped(moved, old) == raw


def test_as_rclpy_writes_it():
    serialization = pytest.importorskip("rclpy.serialization")
    messages = pytest.importorskip("geometry_msgs.msg")
    message = messages.WrenchStamped()
    message.header.stamp.sec, message.header.stamp.nanosec = 1234, 567
    assert stamp_ns(serialization.serialize_message(message)) == 1234 * 10**9 + 567


@pytest.mark.parametrize("raw", [b"", b"\0\1\0\0", b"\0\3" + bytes(20)])
def test_other_bytes_are_refused(raw):
    with pytest.raises(ContractError, match="no message with a stamp"):
        stamp_ns(raw)
