"""An encoder whose zero is not the model's."""

from __future__ import annotations

from cablesense_gap.robot.effects.effect import Effect, Parameter, Scale, Values, joint_unit, size
from cablesense_gap.robot.model import Change, Robot


class JointZero(Effect):
    """What the encoder reads where the model has its zero."""

    name = "joint_zero"
    about = "a joint zero that is off"
    advice = "Home the joint anew, against a mark or a level."
    in_model = False
    of_zeros = True

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        unit = joint_unit(robot, "{position}")
        return (size("zero_rad", unit, 0.6, 0.03, "read at the true zero"),)

    def act(self, change: Change, at: int, values: Values) -> None:
        change.zero[at] += values["zero_rad"]
