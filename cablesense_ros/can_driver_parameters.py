"""The CAN driver node's parameters."""

from __future__ import annotations

from typing import Final

from cablesense_ros.node_parameters import NodeParameter

CAN_DRIVER_PARAMETERS: Final = (
    NodeParameter("arm", "cdsm", "Arm file: the name of a bundled one, or a path."),
    NodeParameter(
        "map",
        "twelve_channel_amplifier",
        "Channel map: the name of a bundled one, or the path of a .yaml file.",
    ),
    NodeParameter(
        "calibration",
        "",
        "Path of a calibration file, whose scales and zeros take the place of the map's; empty "
        "for none.",
    ),
    NodeParameter(
        "interface",
        "socketcan",
        "python-can's name of the kind of adapter: socketcan, slcan, pcan, kvaser, virtual, "
        "udp_multicast.",
    ),
    NodeParameter(
        "channel", "can0", "What that kind calls its channels: can0, /dev/ttyACM0, PCAN_USBBUS1."
    ),
    NodeParameter(
        "bitrate_bit_s",
        0,
        "Bit rate of the bus, bit/s; 0 where the system sets it (socketcan) or there is none.",
        0,
        1_000_000,
    ),
    NodeParameter(
        "autostart", True, "Configure and activate at start, without a lifecycle manager."
    ),
    NodeParameter("frame_prefix", "", "Goes before every frame name."),
    NodeParameter(
        "stale_after_s",
        0.2,
        "Without a sample for this long diagnostics say stale, s.",
        0.001,
        60.0,
    ),
)
