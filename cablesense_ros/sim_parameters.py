"""The sim node's parameters."""

from __future__ import annotations

from typing import Final

from cablesense_ros.node_parameters import NodeParameter

SIM_PARAMETERS: Final = (
    NodeParameter("arm", "cdsm", "Arm file: the name of a bundled one, or a path."),
    NodeParameter(
        "rate_hz",
        0.0,
        "Rate of cable_tensions, Hz; 0 takes the sensors' rate from the arm file.",
        0.0,
        1000.0,
    ),
    NodeParameter(
        "noise", True, "Whether readings have the sensors' noise and step; else true tensions."
    ),
    NodeParameter("seed", 0, "Seed of the noise.", 0, 2**31 - 1),
    NodeParameter(
        "frame_prefix",
        "",
        "Goes before every frame name, as robot_state_publisher's parameter does.",
    ),
    NodeParameter(
        "load_timeout_s",
        0.0,
        "A load lapses this many seconds after its last message; 0: it holds until changed.",
        0.0,
        3600.0,
    ),
    NodeParameter(
        "joint_speed_deg_s",
        20.0,
        "Peak speed at which joints approach a command, deg/s; the estimator must know it too.",
        0.1,
        360.0,
    ),
)
