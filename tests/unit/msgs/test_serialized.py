"""Serialized messages: read, written and stamped as rclpy does it, and refused in one line."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_msgs_py.serialized import (
    MAX_MESSAGE_BYTES,
    EffortReader,
    EffortWriter,
    WrenchWriter,
    stamp_ns,
)
from cablesense_msgs_py.topics import ContractError

serialization = pytest.importorskip("rclpy.serialization")
sensor_msgs = pytest.importorskip("sensor_msgs.msg")

NAMES = st.lists(
    st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=20),
    max_size=20,
)

pytestmark = pytest.mark.filterwarnings("ignore:module .sre_:DeprecationWarning")  # lark
VALUES = st.lists(st.floats(allow_nan=False), max_size=20)


def serialized(names=(), effort=(), frame="base_link", position=(), velocity=(), stamp=(5, 7)):
    message = sensor_msgs.JointState(
        name=list(names), effort=list(effort), position=list(position), velocity=list(velocity)
    )
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = stamp
    return serialization.serialize_message(message)


def big_endian(names, effort, stamp=(5, 7)):
    """The same layout written by hand, most significant byte first, with an empty frame."""
    body = struct.pack(">iI", *stamp) + struct.pack(">I", 1) + b"\0"
    body += b"\0" * (-len(body) % 4) + struct.pack(">I", len(names))
    for name in names:
        text = name.encode() + b"\0"
        body += b"\0" * (-len(body) % 4) + struct.pack(">I", len(text)) + text
    body += b"\0" * (-len(body) % 4) + struct.pack(">III", 0, 0, len(effort))
    body += b"\0" * (-len(body) % 8 if effort else 0)
    return b"\0\0\0\0" + body + struct.pack(f">{len(effort)}d", *effort)


@given(NAMES, VALUES, VALUES, VALUES, st.text(st.characters(codec="ascii", min_codepoint=1)))
def test_reads_what_rclpy_writes(names, position, velocity, effort, frame):
    read = EffortReader().read(serialized(names, effort, frame, position, velocity))
    assert read == (5_000_000_007, tuple(names), tuple(effort))


@given(NAMES, st.data())
def test_writes_what_rclpy_reads(names, data):
    effort = data.draw(
        st.lists(st.floats(allow_nan=False), min_size=len(names), max_size=len(names))
    )
    raw = EffortWriter(names).write(5_000_000_007, effort)
    message = serialization.deserialize_message(raw, sensor_msgs.JointState)
    assert (list(message.name), list(message.effort)) == (names, effort)
    assert not message.position
    assert not message.velocity
    assert EffortReader().read(raw) == (5_000_000_007, tuple(names), tuple(effort))


@given(NAMES, VALUES)
def test_reads_the_other_byte_order(names, effort):
    assert EffortReader().read(big_endian(names, effort))[1:] == (tuple(names), tuple(effort))


@given(st.lists(st.tuples(st.sampled_from(["ab", "abc", "abcd"]), st.integers(0, 3)), max_size=30))
def test_one_reader_takes_changing_messages(changes):
    reader = EffortReader()
    for number, (name, count) in enumerate(changes):
        values = [float(number + i) for i in range(count)]
        write = big_endian if number % 3 == 0 else serialized
        assert reader.read(write([name] * count, values))[1:] == ((name,) * count, tuple(values))


@given(st.data())
def test_every_shortened_message_is_refused(data):
    whole = big_endian(["cable_1", "cable_22"], [1.0, 2.0])
    reader = EffortReader()
    if data.draw(st.booleans()):
        reader.read(whole)
    with pytest.raises(ContractError):
        reader.read(whole[: data.draw(st.integers(0, len(whole) - 1))])


@pytest.mark.parametrize(
    ("raw", "complaint"),
    [
        (b"", "begins 0000 or 0001"),
        (b"\0\2\0\0" + bytes(60), "begins 0000 or 0001"),
        (b"\0\1\0\0" + bytes(8) + struct.pack("<II", 0, 5000) + bytes(40), "5000 entries"),
        (b"\0\1\0\0" + bytes(8) + struct.pack("<I", 4_000_000_000), "4000000000 bytes announced"),
        (big_endian([], [], (1, 2_000_000_000)), "nanosec is 2000000000"),
    ],
)
def test_other_bytes_are_refused_with_the_reason(raw, complaint):
    with pytest.raises(ContractError, match=complaint):
        EffortReader().read(raw)


geometry_msgs = pytest.importorskip("geometry_msgs.msg")


VECTOR = st.tuples(*[st.floats(allow_nan=False)] * 3)


@given(
    st.text(st.characters(codec="ascii", min_codepoint=1)), VECTOR, VECTOR, st.integers(0, 2**60)
)
def test_rclpy_reads_the_same(frame, force, torque, written_ns):
    raw = WrenchWriter(frame).write(written_ns, force + torque)
    message = serialization.deserialize_message(raw, geometry_msgs.WrenchStamped)
    wrench = message.wrench
    stamp = message.header.stamp
    assert message.header.frame_id == frame
    assert stamp.sec * 10**9 + stamp.nanosec == written_ns == stamp_ns(raw)
    assert (wrench.force.x, wrench.force.y, wrench.force.z) == force
    assert (wrench.torque.x, wrench.torque.y, wrench.torque.z) == torque


@pytest.mark.parametrize("field", ["name", "position", "effort"])
def test_a_message_that_is_too_long_is_refused_unread(field):
    count = MAX_MESSAGE_BYTES // 8 + 1
    values = ["joint"] * count if field == "name" else [0.0] * count
    message = sensor_msgs.JointState(**{field: values})
    with pytest.raises(ContractError, match=f"bytes; .* at most {MAX_MESSAGE_BYTES}"):
        EffortReader().read(serialization.serialize_message(message))
