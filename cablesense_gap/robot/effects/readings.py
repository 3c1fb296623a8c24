"""Errors of encoders and torque readings, and the tolerances of all parts.

Tolerances are fitted together with all effects, and never the cause of a gap.
"""

from __future__ import annotations

import numpy as np

from cablesense_gap.robot.effects import (
    WHOLE_ARM,
    Parameter,
    RobotEffect,
    Values,
    joint_unit,
    size,
)
from cablesense_gap.robot.model import Change, Robot
from cablesense_gap.robot.motion import Scale


class EncoderScale(RobotEffect):
    """Positions that are too large by a share."""

    name = "encoder_scale"
    about = "an encoder with a wrong scale"
    adds = "encoder_scale"
    advice = "Compare the gear ratio and the encoder's counts with the data sheet."
    in_model = False
    numbers = (size("share", "1", 0.5, 0.02, "read too much"),)


class JointZero(RobotEffect):
    """The encoder's reading at the model's zero."""

    name = "joint_zero"
    about = "a joint zero that is off"
    adds = "zero"
    advice = "Home the joint again, against a mark or a level."
    in_model = False
    of_zeros = True
    numbers = (size("zero_rad", "{position}", 0.6, 0.03, "read at the true zero"),)


class TorqueScale(RobotEffect):
    """Torques that read too much by a share, at one joint or at all."""

    name = "torque_scale"
    about = "a wrong torque constant"
    advice = "Measure the torque constant with a weight on a lever, and compare the gear ratio."
    in_model = False
    of_torques = True
    of_gains = True
    numbers = (size("share", "1", 0.9, 0.05, "read too much"),)

    def places(self, robot: Robot) -> tuple[str, ...]:
        """Every joint, and the whole robot."""
        return (*robot.joints, *((WHOLE_ARM,) if len(robot.joints) > 1 else ()))

    def act(self, change: Change, at: int, values: Values) -> None:
        joints = slice(None) if at == len(change.torque_scale) else slice(at, at + 1)
        change.torque_scale[joints] += values["share"]


class TorqueOffset(RobotEffect):
    """The torque that is read without a torque."""

    name = "torque_offset"
    about = "a torque zero that is off"
    adds = "torque_offset"
    advice = "Read the torque with the drive off, or the current at standstill from both sides."
    in_model = False
    of_torques = True
    numbers = (size("torque_n_m", "{torque}", 3.0, 0.05, "read without a torque"),)

    def usual(self, robot: Robot, scale: Scale) -> float:
        return scale.typical_torque


class TorqueDelay(RobotEffect):
    """A delay of torques by filters and buses; negative: the motion is late."""

    name = "torque_delay"
    at = "arm"
    about = "a delay between motion and torque"
    advice = "Compare the filters and stamps of encoders and currents."
    in_model = False
    numbers = (size("time_s", "s", 0.1, 0.005, "torques later than positions"),)

    def act(self, change: Change, at: int, values: Values) -> None:
        change.delay_s += values["time_s"]


class LinkTolerance(RobotEffect):
    """Masses to 1 %, centres to a millimetre."""

    name = "link_tolerance"
    at = "bodies"
    about = "tolerances of masses and centres"
    tolerance = True
    numbers = (
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


class CurrentGain(RobotEffect):
    """Torque constants that nobody has stated, about those that fit the nominal robot best.

    These are off as far as the masses of the model are, which is as far as they are known.
    """

    name = "current_gain"
    about = "torque constants that are unknown"
    adds = "torque_scale"
    tolerance = True
    in_model = False
    of_torques = True
    of_currents = True
    numbers = (size("share", "1", 3.0, 0.3, "read too much", least=-0.9),)


class TimingTolerance(TorqueDelay):
    """Torques later than positions, or earlier, by 2 ms, at most 5: filters and buses."""

    name = "timing_tolerance"
    at = "arm"
    about = "tolerances of timing"
    tolerance = True
    in_model = False
    numbers = (size("time_s", "s", 0.005, 0.002, "torques later than positions"),)
