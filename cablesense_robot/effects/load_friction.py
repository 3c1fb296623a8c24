"""Dry friction that grows with the load."""

from __future__ import annotations

from cablesense_robot.effects.effect import Effect, Parameter, Scale, Values, size
from cablesense_robot.model import Change, Robot


class LoadFriction(Effect):
    """A torque against the motion, in proportion to what the joint transmits, as of gears."""

    name = "load_friction"
    about = "friction that grows with the load"
    advice = (
        "Check gears, screws, and cables over guides: their losses grow with what they transmit."
    )
    in_model = False

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        return (size("share", "1", 0.9, 0.05, "of the transmitted torque", 0.0),)

    def act(self, change: Change, at: int, values: Values) -> None:
        change.load_friction[at] += values["share"]
