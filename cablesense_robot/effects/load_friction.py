"""Dry friction that grows with the load."""

from __future__ import annotations

from cablesense_robot.effects.effect import (
    PRESLIDING,
    Effect,
    Parameter,
    Scale,
    Values,
    presliding,
    size,
)
from cablesense_robot.model import Change, Robot


class LoadFriction(Effect):
    """A drive gives e^share times what the joint transmits, and where it brakes e^-share times.

    So do gears, and cables over guides by Euler's law, share being friction times wrap angle.
    """

    name = "load_friction"
    about = "friction that grows with the load"
    advice = (
        "Check gears, screws, and cables over guides: their losses grow with what they transmit."
    )
    in_model = False
    against_motion = True

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        loss = size("share", "1", 0.9, 0.05, "logarithm of the loss", 0.0)
        return loss, presliding(robot, scale)

    def act(self, change: Change, at: int, values: Values) -> None:
        change.load_friction[at] += values["share"]
        change.load_presliding[at] = values[PRESLIDING]
