"""Play between a drive and its joint."""

from __future__ import annotations

from cablesense_gap.robot.effects.effect import Effect, Parameter, Scale, Values, joint_unit, size
from cablesense_gap.robot.model import Change, Robot


class Backlash(Effect):
    """A gap between drive and joint: the joint is driven at either end of it, and free between.

    Positions are taken to be the drive's. Where the joint is in the gap follows from the torque
    that its link needs.
    """

    name = "backlash"
    about = "backlash"
    source = "Nordin and Gutman, Controlling mechanical systems with backlash, Automatica 38, 2002"
    advice = "Hold the drive and move the joint by hand: gears, couplings, belts that are slack."
    in_model = False

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        unit = joint_unit(robot, "{position}")
        return (size("play_rad", unit, 0.3, 0.01, "from one side of the gap to the other", 0.0),)

    def act(self, change: Change, at: int, values: Values) -> None:
        change.play[at] += values["play_rad"]
