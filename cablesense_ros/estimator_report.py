"""The estimator's health beyond its input: model, pose and cables."""

from __future__ import annotations

from cablesense_msgs_py.diagnostics import Level, Status
from cablesense_ros.estimation import Estimation
from cablesense_ros.loaded_model import LoadedModel


def cable_status(estimation: Estimation) -> Status:
    """Which cables are slack. The estimate goes on: statics holds with slack cables too."""
    slack = estimation.check.slack
    names = ", ".join(f"cable_{number}" for number in slack) or "none"
    level, message = (Level.WARN, f"slack: {names}") if slack else (Level.OK, "all cables taut")
    return Status(
        "cables",
        level,
        message,
        {"slack": names, "slack below (N)": f"{estimation.check.slack_below_n:g}"},
    )


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
    if not active:
        return Status("model", Level.WARN, "configured, not active", values)
    if largest_force_n > metadata.force_range_n:
        return Status("model", Level.WARN, "forces beyond those it was trained on", values)
    return Status("model", Level.OK, "active", values)


_BLIND = "moving: no estimate until the arm rests"


def pose_status(estimation: Estimation, pose_range_deg: float, refused_commands: int) -> Status:
    """What is known of the arm's pose; the model was trained within ± `pose_range_deg`."""
    values = {
        "commands refused": str(refused_commands),
        "command (deg)": ", ".join(f"{angle:.2f}" for angle in estimation.command_deg),
    }
    if refused_commands:
        return Status("joint_commands", Level.ERROR, "a command was refused; see the log", values)
    if estimation.gate.shut:
        moving = "moving" if estimation.answers_in_motion else _BLIND
        return Status("joint_commands", Level.OK, moving, values)
    if max(map(abs, estimation.command_deg)) > pose_range_deg + 1e-6:
        return Status(
            "joint_commands",
            Level.WARN,
            f"beyond the poses that the model was trained on (±{pose_range_deg:g} degrees)",
            values,
        )
    if not estimation.command_received:
        return Status(
            "joint_commands", Level.WARN, "none received: arm taken to be straight", values
        )
    return Status("joint_commands", Level.OK, "at rest", values)
