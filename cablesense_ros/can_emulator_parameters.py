"""The CAN emulator node's parameters."""

from __future__ import annotations

from typing import Final

from cablesense_ros.node_parameters import NodeParameter

SLCAN_PORT: Final = "slcan_port"
"""The interface that is none of python-can's: a pseudo-terminal that poses as an adapter."""

CAN_EMULATOR_PARAMETERS: Final = (
    NodeParameter("arm", "cdsm", "Arm file: the name of a bundled one, or a path."),
    NodeParameter(
        "map",
        "twelve_channel_amplifier",
        "Channel map: the name of a bundled one, or the path of a .yaml file.",
    ),
    NodeParameter(
        "interface",
        SLCAN_PORT,
        "slcan_port poses as a serial adapter on a pseudo-terminal; else python-can's name of an "
        "interface, such as socketcan.",
    ),
    NodeParameter(
        "channel",
        "/tmp/cablesense_can",
        "With slcan_port, the path of a link to the terminal; else the interface's channel, such "
        "as vcan0.",
    ),
    NodeParameter(
        "bitrate_bit_s",
        0,
        "Bit rate of the bus, bit/s; 0 where the system sets it or there is none.",
        0,
        1_000_000,
    ),
    NodeParameter(
        "recording",
        "",
        "Recording to play, a .csv or .mcap file; empty: what comes on simulated_tensions.",
    ),
    NodeParameter("loop", False, "Play the recording again when it has ended."),
    NodeParameter(
        "fault",
        "",
        "What goes wrong, such as 'missing_channel cable_5' or bus_off; empty for nothing. May "
        "change at any time.",
    ),
)
