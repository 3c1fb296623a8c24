"""Manufacturing tolerances: fitted together with all effects, and never the cause of a gap."""

from __future__ import annotations

import numpy as np

from cablesense_gap.robot.effects.effect import (
    WHOLE_ARM,
    Parameter,
    RobotEffect,
    Scale,
    Values,
    joint_unit,
    size,
)
from cablesense_gap.robot.model import Change, Robot


class LinkTolerance(RobotEffect):
    """Masses to 1 %, centres to a millimetre."""

    name = "link_tolerance"
    about = "tolerances of masses and centres"
    tolerance = True

    def places(self, robot: Robot) -> tuple[str, ...]:
        return robot.bodies

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        return (
            size("share", "1", 0.1, 0.01, "heavier than modelled"),
            *(size(f"{axis}_m", "m", 0.01, 0.001, f"along the link's {axis}") for axis in "xyz"),
        )

    def act(self, change: Change, at: int, values: Values) -> None:
        change.mass_kg[at] *= 1.0 + values["share"]
        change.inertia_kg_m2[at] *= 1.0 + values["share"]
        change.centre_m[at] += [values[f"{axis}_m"] for axis in "xyz"]


class DriveTolerance(RobotEffect):
    """Zeros to 0.1°, torque constants to 1 %, torque zeros to 0.2 %, dampers and rotors to 3 %."""

    name = "drive_tolerance"
    about = "tolerances of encoders and torques"
    tolerance = True
    in_model = False

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        typical = 0.002 * scale.typical_torque
        zero = float(np.deg2rad(0.1))
        angle, torque = (joint_unit(robot, form) for form in ("{position}", "{torque}"))
        return (
            size("zero_rad", angle, 10.0 * zero, zero, "read at the true zero"),
            size("share", "1", 0.1, 0.01, "read too much"),
            size("torque_n_m", torque, 10.0 * typical, typical, "read without torque"),
            size("damping_share", "1", 0.3, 0.03, "more damping than modelled"),
            size("rotor_share", "1", 0.3, 0.03, "more inertia of the rotor than modelled"),
        )

    def act(self, change: Change, at: int, values: Values) -> None:
        change.zero[at] += values["zero_rad"]
        change.torque_scale[at] += values["share"]
        change.torque_offset[at] += values["torque_n_m"]
        change.damping[at] *= 1.0 + values["damping_share"]
        change.armature[at] *= 1.0 + values["rotor_share"]


class TimingTolerance(RobotEffect):
    """Torques later than positions, or earlier, by 2 ms, at most 5: filters and buses."""

    name = "timing_tolerance"
    about = "tolerances of timing"
    tolerance = True
    in_model = False

    def places(self, robot: Robot) -> tuple[str, ...]:
        return (WHOLE_ARM,)

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        return (size("time_s", "s", 0.005, 0.002, "torques later than positions"),)

    def act(self, change: Change, at: int, values: Values) -> None:
        change.delay_s += values["time_s"]
