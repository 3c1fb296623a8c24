"""A torque that reads from a wrong zero."""

from __future__ import annotations

from cablesense_gap.robot.effects.effect import Effect, Parameter, Scale, Values, joint_unit, size
from cablesense_gap.robot.model import Change, Robot


class TorqueOffset(Effect):
    """What is read without a torque."""

    name = "torque_offset"
    about = "a torque zero that is off"
    advice = "Read the torque with the drive off, or the current at standstill from both sides."
    in_model = False

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        most, typical = 3.0 * scale.typical_torque, 0.05 * scale.typical_torque
        unit = joint_unit(robot, "{torque}")
        return (size("torque_n_m", unit, most, typical, "read without a torque"),)

    def act(self, change: Change, at: int, values: Values) -> None:
        change.torque_offset[at] += values["torque_n_m"]
