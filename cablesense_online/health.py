"""The estimator's health in diagnostics, beyond its input: model, cables, pose and tare."""

from __future__ import annotations

import numpy as np

from cablesense_msgs_py.messages import Level, Status
from cablesense_online.models import LoadedModel
from cablesense_online.motion_gate import MotionGate
from cablesense_online.samples import SampleCheck
from cablesense_online.tare import Tares, time_text


def cable_status(check: SampleCheck) -> Status:
    """Which cables are slack. The estimate goes on: statics holds with slack cables too."""
    names = ", ".join(f"cable_{number}" for number in check.slack) or "none"
    level, message = (
        (Level.WARN, f"slack: {names}") if check.slack else (Level.OK, "all cables taut")
    )
    values = {"slack": names, "slack below (N)": f"{check.slack_below_n:g}"}
    return Status("cables", level, message, values)


def pose_status(
    gate: MotionGate, pose_range_deg: float, refused: int, *, received: bool, in_motion: bool
) -> Status:
    """What is known of the arm's pose.

    Args:
        gate: with the command in force.
        pose_range_deg: the model was trained within ± this.
        refused: commands that were refused since the last report.
        received: whether any command has come.
        in_motion: whether the model estimates while the arm moves.
    """
    command_deg = [float(angle) for angle in np.rad2deg(gate.command_rad)]
    values = {
        "commands refused": str(refused),
        "command (deg)": ", ".join(f"{angle:.2f}" for angle in command_deg),
    }
    level, message = Level.OK, "at rest"
    if refused:
        level, message = Level.ERROR, "a command was refused; see the log"
    elif gate.shut:
        message = "moving" if in_motion else "moving: no estimate until the arm rests"
    elif max(map(abs, command_deg)) > pose_range_deg + 1e-6:
        level = Level.WARN
        message = f"beyond the poses that the model was trained on (±{pose_range_deg:g} degrees)"
    elif not received:
        level, message = Level.WARN, "none received: arm taken to be straight"
    return Status("joint_commands", level, message, values)


def tare_status(tares: Tares) -> Status:
    """Whether there is a tare, since when, and how far it lies from the arm's model."""
    tare = tares.present
    if tare is None:
        return Status(
            "tare", Level.WARN, "none taken: no estimate; call ~/tare with the arm unloaded"
        )
    since = time_text(tare.taken_ns)
    values = {
        "tared since": since,
        "readings averaged": str(tare.sample_count),
        "largest deviation from the arm file (N)": f"{tare.offset_n:.2f}",
        "unloaded tensions (N)": ", ".join(f"{tension:.2f}" for tension in tare.measured_n),
        "tares that can be undone": str(tares.undoable),
    }
    return Status("tare", Level.OK, f"tared since {since}", values)


def model_status(loaded: LoadedModel, largest_force_n: float, active: bool) -> Status:
    """Which model and arm, and whether the latest forces were within its training."""
    metadata = loaded.estimator.metadata
    values = {
        "model": loaded.model,
        "network": metadata.network,
        "arm": loaded.arm.identity,
        "trained up to (N)": f"{metadata.force_range_n:g}",
        "largest force (N)": f"{largest_force_n:.1f}",
    }
    level, message = Level.OK, "active"
    if not active:
        level, message = Level.WARN, "configured, not active"
    elif largest_force_n > metadata.force_range_n:
        level, message = Level.WARN, "forces beyond those it was trained on"
    return Status("model", level, message, values)
