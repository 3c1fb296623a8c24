"""CANopen network management (CiA 301): amplifiers that send only once they were started."""

from __future__ import annotations

from collections.abc import Sequence

import can

NMT_ID = 0x000
START_REMOTE_NODE = 0x01
HEARTBEAT_ID = 0x700
BOOT_UP = b"\x00"


def start_frames(nodes: Sequence[int]) -> list[can.Message]:
    """One NMT start for each node, numbers 1 to 127."""
    return [
        can.Message(arbitration_id=NMT_ID, is_extended_id=False, data=[START_REMOTE_NODE, node])
        for node in nodes
    ]


def booted_node(frame: can.Message, nodes: Sequence[int]) -> int | None:
    """Which of the nodes says by this frame that it has just got power, if it is such a frame.

    It then waits in the state pre-operational, and must be started again.
    """
    node = frame.arbitration_id - HEARTBEAT_ID
    plain = not (frame.is_extended_id or frame.is_remote_frame or frame.is_error_frame)
    if plain and node in nodes and bytes(frame.data) == BOOT_UP:
        return node
    return None
