"""A torque that reads from a wrong zero."""

from __future__ import annotations

from cablesense_robot.effects.effect import Effect, Parameter, Scale, Values, size, torque_unit
from cablesense_robot.model import Change, Robot


class TorqueOffset(Effect):
    """What is read without a torque."""

    name = "torque_offset"
    about = "a torque zero that is off"
    advice = "Read the torque with the drive off, or the current at standstill from both sides."
    in_model = False

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        most = 3.0 * scale.typical_torque
        about = "read without a torque"
        return (size("torque_n_m", torque_unit(robot), most, 0.05 * scale.typical_torque, about),)

    def act(self, change: Change, at: int, values: Values) -> None:
        change.torque_offset[at] += values["torque_n_m"]
