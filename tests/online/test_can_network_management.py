"""NMT: starting nodes, and noticing one that has just got power."""

import can
import pytest

from cablesense_online.can.bus import booted_node, start_frames


def test_each_node_is_started_by_command_and_number_on_id_0():
    frames = start_frames([3, 12])
    assert [frame.arbitration_id for frame in frames] == [0, 0]
    assert [bytes(frame.data) for frame in frames] == [b"\x01\x03", b"\x01\x0c"]
    assert not any(frame.is_extended_id for frame in frames)


@pytest.mark.parametrize(
    ("number", "data", "node"),
    [
        (0x703, [0], 3),
        (0x703, [5], None),
        (0x703, [], None),
        (0x704, [0], None),
        (0x003, [0], None),
    ],
)
def test_a_boot_up_message_of_a_node_of_ours(number, data, node):
    frame = can.Message(arbitration_id=number, is_extended_id=False, data=data)
    assert booted_node(frame, [3, 12]) == node


def test_an_extended_frame_is_no_boot_up():
    assert booted_node(can.Message(arbitration_id=0x703, data=[0]), [3]) is None
