"""Dry friction that grows with the load."""

from __future__ import annotations

from cablesense_gap.robot.effects.effect import (
    PRESLIDING,
    SIDE,
    Effect,
    Parameter,
    Scale,
    Values,
    presliding,
    size,
)
from cablesense_gap.robot.model import Change, Robot


class LoadFriction(Effect):
    """A drive gives e^share times what the joint transmits, and where it brakes e^-share times.

    So do cables over guides by Euler's law, share being friction times wrap angle. Of gears some
    state friction as a part of the drive's torque, 1 / (1 ± tanh share) of it, others of the
    joint's, 1 ± tanh share: both are e^±share times cosh share, to the power of 1 and of -1.
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
        about = "by the drive's torque at 1, by the joint's at -1, by Euler's law at 0"
        side = Parameter(SIDE, "1", -1.0, 1.0, 0.5, about, role="shape")
        return loss, presliding(robot, scale), side

    def act(self, change: Change, at: int, values: Values) -> None:
        change.load_friction[at] += values["share"]
        change.load_presliding[at], change.load_side[at] = values[PRESLIDING], values[SIDE]
