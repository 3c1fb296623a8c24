"""Inertia of a rotor, seen through its gear."""

from __future__ import annotations

from cablesense_gap.robot.effects.effect import Effect, Parameter, Scale, Values, joint_unit, size
from cablesense_gap.robot.model import Change, Robot


class RotorInertia(Effect):
    """Inertia that resists the joint's own acceleration alone."""

    name = "rotor_inertia"
    about = "inertia of a rotor that nobody modelled"
    advice = "Take the rotor's inertia from its data sheet, times the gear ratio squared."

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        typical = 0.05 * scale.per(scale.acceleration)
        unit = joint_unit(robot, "{inertia}")
        about = "as the joint feels it"
        return (size("inertia_kg_m2", unit, 60.0 * typical, typical, about, 0.0),)

    def act(self, change: Change, at: int, values: Values) -> None:
        change.armature[at] += values["inertia_kg_m2"]
