"""A joint that moves with its neighbour's drive."""

from __future__ import annotations

from cablesense_gap.robot.effects.effect import Effect, Parameter, Scale, Values, size
from cablesense_gap.robot.model import Change, Robot


class JointCoupling(Effect):
    """One drive moves the next joint too, as where a cable or belt passes a joint on its way."""

    name = "joint_coupling"
    about = "a joint that moves with its neighbour's drive"
    advice = "Hold all drives but one, turn that, and look whether another joint moves."
    in_model = False

    def places(self, robot: Robot) -> tuple[str, ...]:
        """`a_into_b` for neighbours: the drive of a moves joint b."""
        return tuple(f"{robot.joints[i]}_into_{robot.joints[j]}" for i, j in _neighbours(robot))

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        return (size("share", "1", 1.2, 0.05, "of the drive's motion"),)

    def act(self, change: Change, at: int, values: Values) -> None:
        i, forth = divmod(at, 2)
        drive, joint = (i + 1, i) if forth else (i, i + 1)
        change.coupling[joint, drive] += values["share"]


def _neighbours(robot: Robot) -> list[tuple[int, int]]:
    return [pair for i in range(len(robot.joints) - 1) for pair in ((i, i + 1), (i + 1, i))]
