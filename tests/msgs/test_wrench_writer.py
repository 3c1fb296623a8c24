"""What the writer writes is what rclpy reads."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_msgs_py.serialized import WrenchWriter

serialization = pytest.importorskip("rclpy.serialization")
geometry_msgs = pytest.importorskip("geometry_msgs.msg")

pytestmark = pytest.mark.filterwarnings(
    "ignore:module .sre_:DeprecationWarning"
)  # lark, of rosidl

VECTOR = st.tuples(*[st.floats(allow_nan=False)] * 3)


@given(
    st.text(st.characters(codec="ascii", min_codepoint=1)), VECTOR, VECTOR, st.integers(0, 2**60)
)
def test_rclpy_reads_the_same(frame, force, torque, stamp_ns):
    raw = WrenchWriter(frame).write(stamp_ns, force + torque)
    message = serialization.deserialize_message(raw, geometry_msgs.WrenchStamped)
    wrench = message.wrench
    assert message.header.frame_id == frame
    assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == stamp_ns
    assert (wrench.force.x, wrench.force.y, wrench.force.z) == force
    assert (wrench.torque.x, wrench.torque.y, wrench.torque.z) == torque
