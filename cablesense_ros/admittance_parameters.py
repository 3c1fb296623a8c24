"""The admittance node's parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

from cablesense_ros.admittance.admittance_law import AdmittanceSettings
from cablesense_ros.admittance.controller import ControllerSettings
from cablesense_ros.admittance.estimate_watch import WatchSettings
from cablesense_ros.node_parameters import NodeParameter

ADMITTANCE_PARAMETERS: Final = (
    NodeParameter("arm", "cdsm", "Arm file: the name of a bundled one, or a path."),
    NodeParameter(
        "autostart", True, "Configure and activate at start, without a lifecycle manager."
    ),
    NodeParameter("estimator", "estimator", "Name of the estimator node that is listened to."),
    NodeParameter("frame_prefix", "", "Goes before every frame name, as in the other nodes."),
    NodeParameter(
        "worst_stiffness_n_m",
        20_000.0,
        "The stiffest contact that is expected, N/m; the loop is stable up to twice this.",
        10.0,
        1e8,
    ),
    NodeParameter(
        "deadband_n", 2.0, "Forces up to this one move nothing, N; the aim of all moves.", 0.1, 1e3
    ),
    NodeParameter(
        "damping_n_m_s_rad", 5.0, "Damping D of every joint axis, N·m·s/rad.", 0.01, 1e4
    ),
    NodeParameter(
        "return_stiffness_n_m_rad",
        1.0,
        "Stiffness K of every joint axis towards home, N·m/rad; 0 stays where it is.",
        0.0,
        1e3,
    ),
    NodeParameter(
        "touch_n",
        4.0,
        "Most force, N, with which a step towards home may meet an unseen contact of the worst "
        "stiffness.",
        0.1,
        1e3,
    ),
    NodeParameter(
        "step_limit_deg", 1.0, "No joint turns farther in one step, degrees.", 0.01, 10.0
    ),
    NodeParameter(
        "speed_limit_deg_s",
        5.0,
        "Nor, on the average from one step to the next, faster, degrees per second.",
        0.01,
        90.0,
    ),
    NodeParameter(
        "joint_limit_deg",
        10.0,
        "Largest bend of a joint that is commanded, degrees; guide plates end it earlier.",
        0.1,
        60.0,
    ),
    NodeParameter("measure_s", 0.1, "Estimates are averaged over this time, s.", 0.01, 5.0),
    NodeParameter(
        "stale_after_s", 0.2, "Without a fresh wrench for this long, s, it stops.", 0.05, 5.0
    ),
    NodeParameter(
        "resume_after_s",
        1.0,
        "Estimates must come for this long, s, before they are trusted again.",
        0.0,
        60.0,
    ),
    NodeParameter(
        "yield_s",
        2.0,
        "After a command of another node none is sent for this long, s.",
        0.0,
        3600.0,
    ),
    NodeParameter(
        "await_command",
        False,
        "Send nothing before a command has been heard; else the arm is taken to be straight.",
    ),
    NodeParameter(
        "joint_speed_deg_s",
        20.0,
        "Peak speed at which joints approach a command, deg/s; as the estimator's.",
        0.1,
        360.0,
    ),
    NodeParameter(
        "settle_s", 0.5, "How long the estimator is blind after a move, s; as its own.", 0.0, 60.0
    ),
)


def controller_settings(values: Mapping[str, Any]) -> ControllerSettings:
    """The settings that the parameters' values say."""
    law = AdmittanceSettings(
        damping_n_m_s_rad=values["damping_n_m_s_rad"],
        return_stiffness_n_m_rad=values["return_stiffness_n_m_rad"],
        deadband_n=values["deadband_n"],
        worst_stiffness_n_m=values["worst_stiffness_n_m"],
        step_limit_rad=math.radians(values["step_limit_deg"]),
        speed_limit_rad_s=math.radians(values["speed_limit_deg_s"]),
        touch_n=values["touch_n"],
    )
    watch = WatchSettings(
        stale_after_s=values["stale_after_s"],
        resume_after_s=values["resume_after_s"],
        joint_speed_rad_s=math.radians(values["joint_speed_deg_s"]),
        settle_s=values["settle_s"],
    )
    return ControllerSettings(
        law=law,
        watch=watch,
        joint_limit_rad=math.radians(values["joint_limit_deg"]),
        measure_s=values["measure_s"],
        yield_s=values["yield_s"],
        await_command=values["await_command"],
    )
