"""What lies between a drive and its joint, and springs in the joint."""

from __future__ import annotations

from itertools import pairwise

from cablesense_gap.robot.effects.effect import (
    Parameter,
    RobotEffect,
    Scale,
    Values,
    joint_unit,
    size,
)
from cablesense_gap.robot.model import Change, Robot


class Backlash(RobotEffect):
    """A gap between drive and joint: the joint is driven at either end of it, and free between.

    Positions are taken to be the drive's. The joint's place in the gap follows from the torque
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


class JointCoupling(RobotEffect):
    """One drive moves the next joint too, for example where a cable passes a joint on its way."""

    name = "joint_coupling"
    about = "a joint that moves with its neighbour's drive"
    advice = "Hold all drives but one, turn that, and look whether another joint moves."
    in_model = False

    def places(self, robot: Robot) -> tuple[str, ...]:
        """`a_into_b` for neighbours: the drive of a moves joint b."""
        return tuple(
            f"{drive}_into_{joint}"
            for pair in pairwise(robot.joints)
            for drive, joint in (pair, pair[::-1])
        )

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        return (size("share", "1", 1.2, 0.05, "of the drive's motion"),)

    def act(self, change: Change, at: int, values: Values) -> None:
        i, back = divmod(at, 2)
        drive, joint = (i + 1, i) if back else (i, i + 1)
        change.coupling[joint, drive] += values["share"]


class JointSpring(RobotEffect):
    """A torque in proportion to the joint's position, for example of hoses and wires."""

    name = "joint_spring"
    about = "a spring in the joint"
    advice = "Look at hoses, wires and covers that bend with the joint."

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        typical = 0.05 * scale.per(scale.position)
        unit, about = joint_unit(robot, "{torque}/{position}"), "towards the model's reference"
        return (size("stiffness_n_m_rad", unit, 60.0 * typical, typical, about, 0.0),)

    def act(self, change: Change, at: int, values: Values) -> None:
        change.stiffness[at] += values["stiffness_n_m_rad"]
