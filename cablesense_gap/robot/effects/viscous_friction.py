"""A joint that drags in proportion to its speed."""

from __future__ import annotations

from cablesense_gap.robot.effects.effect import Effect, Parameter, Scale, Values, joint_unit, size
from cablesense_gap.robot.model import Change, Robot


class ViscousFriction(Effect):
    """A torque against the motion that grows with the speed."""

    name = "viscous_friction"
    about = "viscous friction"
    advice = "Check the lubricant and its temperature."

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        typical = 0.05 * scale.per(scale.speed)
        unit = joint_unit(robot, "{torque} s/{position}")
        return (size("torque_s_n_m", unit, 60.0 * typical, typical, "by the speed", 0.0),)

    def act(self, change: Change, at: int, values: Values) -> None:
        change.damping[at] += values["torque_s_n_m"]
