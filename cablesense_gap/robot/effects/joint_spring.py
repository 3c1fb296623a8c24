"""A spring that pulls a joint back."""

from __future__ import annotations

from cablesense_gap.robot.effects.effect import Effect, Parameter, Scale, Values, joint_unit, size
from cablesense_gap.robot.model import Change, Robot


class JointSpring(Effect):
    """A torque in proportion to the joint's position, as of hoses and wires."""

    name = "joint_spring"
    about = "a spring in the joint"
    advice = "Look at hoses, wires and covers that bend with the joint."

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        typical = 0.05 * scale.per(scale.position)
        unit = joint_unit(robot, "{torque}/{position}")
        about = "towards the model's spring reference"
        return (size("stiffness_n_m_rad", unit, 60.0 * typical, typical, about, 0.0),)

    def act(self, change: Change, at: int, values: Values) -> None:
        change.stiffness[at] += values["stiffness_n_m_rad"]
