"""What encoders and torque readings add to the truth."""

from __future__ import annotations

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


class EncoderScale(RobotEffect):
    """Positions that are too large by a share."""

    name = "encoder_scale"
    about = "an encoder with a wrong scale"
    advice = "Compare the gear ratio and the encoder's counts with the data sheet."
    in_model = False

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        return (size("share", "1", 0.5, 0.02, "read too much"),)

    def act(self, change: Change, at: int, values: Values) -> None:
        change.encoder_scale[at] += values["share"]


class JointZero(RobotEffect):
    """The encoder's reading at the model's zero."""

    name = "joint_zero"
    about = "a joint zero that is off"
    advice = "Home the joint again, against a mark or a level."
    in_model = False
    of_zeros = True

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        unit = joint_unit(robot, "{position}")
        return (size("zero_rad", unit, 0.6, 0.03, "read at the true zero"),)

    def act(self, change: Change, at: int, values: Values) -> None:
        change.zero[at] += values["zero_rad"]


class TorqueScale(RobotEffect):
    """Torques that read too much by a share, at one joint or at all."""

    name = "torque_scale"
    about = "a wrong torque constant"
    advice = "Measure the torque constant with a weight on a lever, and compare the gear ratio."
    in_model = False

    def places(self, robot: Robot) -> tuple[str, ...]:
        """Every joint, and the whole robot."""
        return (*robot.joints, *((WHOLE_ARM,) if len(robot.joints) > 1 else ()))

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        return (size("share", "1", 0.9, 0.05, "read too much"),)

    def act(self, change: Change, at: int, values: Values) -> None:
        joints = slice(None) if at == len(change.torque_scale) else slice(at, at + 1)
        change.torque_scale[joints] += values["share"]


class TorqueOffset(RobotEffect):
    """The torque that is read without a torque."""

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


class TorqueDelay(RobotEffect):
    """A delay of torques by filters and buses; negative: the motion is late."""

    name = "torque_delay"
    about = "a delay between motion and torque"
    advice = "Compare the filters and stamps of encoders and currents."
    in_model = False

    def places(self, robot: Robot) -> tuple[str, ...]:
        return (WHOLE_ARM,)

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        return (size("time_s", "s", 0.1, 0.005, "torques later than positions"),)

    def act(self, change: Change, at: int, values: Values) -> None:
        change.delay_s += values["time_s"]
