"""The obstacle node's parameters; `LIVE_PARAMETERS` may change while it runs."""

from __future__ import annotations

from typing import Final

from cablesense_ros.node_parameters import NodeParameter

OBSTACLE_PARAMETERS: Final = (
    NodeParameter("arm", "cdsm", "Arm file: the name of a bundled one, or a path."),
    NodeParameter("frame_prefix", "", "Goes before every frame name, as in the other nodes."),
    NodeParameter("segment", 3, "The segment that the wall presses on.", 1, 1000),
    NodeParameter(
        "angle_deg",
        90.0,
        "Direction of the push, normal to the segment as the wall first sees it, degrees from "
        "the segment's +z towards its +y.",
        -360.0,
        360.0,
    ),
    NodeParameter("stiffness_n_m", 10_000.0, "Of the wall, N/m.", 1.0, 1e7),
    NodeParameter("damping_n_s_m", 0.0, "Of the wall, N·s/m.", 0.0, 1e5),
    NodeParameter("clearance_m", 0.005, "How far off the wall begins, m.", 0.0, 1.0),
    NodeParameter(
        "depth_m",
        0.003,
        "Where the wall stops, m beyond the contact point as it first saw it; negative is off "
        "the arm.",
        -1.0,
        0.2,
    ),
    NodeParameter("speed_m_s", 0.005, "How fast the wall moves, m/s.", 1e-5, 1.0),
    NodeParameter(
        "delay_s", 5.0, "How long the wall waits at first: the estimator's tare.", 0.0, 3600.0
    ),
)

LIVE_PARAMETERS: Final = ("depth_m", "speed_m_s")
