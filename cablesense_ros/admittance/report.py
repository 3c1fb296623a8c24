"""What the controller says of itself in diagnostics."""

from __future__ import annotations

import numpy as np

from cablesense_msgs_py.diagnostics import Level, Status
from cablesense_ros.admittance.controller import AdmittanceController
from cablesense_ros.admittance.estimate_watch import Sight


def control_status(
    controller: AdmittanceController, active: bool, commanders: int, now_s: float
) -> Status:
    """Phase, last contact and pose; `commanders` publish joint commands, this node included."""
    level, message = _verdict(controller, active, commanders, now_s)
    felt = controller.felt
    values = {
        "sight": controller.watch.sight.value,
        "last contact": (
            "none"
            if felt is None
            else f"segment {felt.segment}, {np.linalg.norm(felt.force_base_n):.2f} N"
        ),
        "steps": str(controller.step_count),
        "command (deg)": _degrees(controller.command_rad),
        "home (deg)": _degrees(controller.home_rad),
        "commanders": str(commanders),
    }
    return Status("control", level, message, values)


def _verdict(
    controller: AdmittanceController, active: bool, commanders: int, now_s: float
) -> tuple[Level, str]:
    if not active:
        return Level.OK, "configured, not active: no commands are sent"
    if controller.watch.sight is Sight.STOPPED:
        return Level.ERROR, f"stopped: {controller.watch.reason}"
    if controller.awaiting:
        return Level.WARN, "waits for a first command"
    if controller.yielding(now_s):
        return Level.WARN, "another node commands; quiet"
    if controller.beyond_reach:
        return Level.WARN, "the arm was commanded beyond joint_limit_deg; no step is taken"
    if controller.felt is not None and controller.at_limit:
        return Level.WARN, "at joint_limit_deg: what force is left stays"
    if commanders > 1:
        return Level.OK, f"{controller.watch.sight.value}; {commanders} nodes can command"
    return Level.OK, controller.watch.sight.value


def _degrees(angles_rad: np.ndarray) -> str:
    return ", ".join(f"{angle:.3f}" for angle in np.rad2deg(angles_rad))
