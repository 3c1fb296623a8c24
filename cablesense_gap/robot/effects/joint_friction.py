"""A joint that sticks and slips."""

from __future__ import annotations

from cablesense_gap.robot.effects.effect import (
    PRESLIDING,
    Effect,
    Parameter,
    Scale,
    Values,
    joint_unit,
    presliding,
    size,
)
from cablesense_gap.robot.model import Change, Robot


class JointFriction(Effect):
    """A torque of one size against the motion, whatever the load: Coulomb's, begun as Dahl's."""

    name = "joint_friction"
    about = "dry friction"
    source = "Dahl, Solid friction damping of mechanical vibrations, AIAA Journal 14(12), 1976"
    advice = "Turn the joint by hand without current: bearings, seals, brakes that drag, gears."
    against_motion = True

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        most, typical = 3.0 * scale.typical_torque, 0.05 * scale.typical_torque
        unit, about = joint_unit(robot, "{torque}"), "against the motion, whatever the load"
        return (
            size("torque_n_m", unit, most, typical, about, 0.0),
            presliding(robot, scale),
        )

    def act(self, change: Change, at: int, values: Values) -> None:
        change.friction[at] += values["torque_n_m"]
        change.presliding[at] = values[PRESLIDING]
