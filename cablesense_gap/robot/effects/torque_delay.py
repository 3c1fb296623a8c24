"""Torques that are read later than the motion."""

from __future__ import annotations

from cablesense_gap.robot.effects.effect import WHOLE_ARM, Effect, Parameter, Scale, Values, size
from cablesense_gap.robot.model import Change, Robot


class TorqueDelay(Effect):
    """A delay between motion and torque, as of filters and buses; negative: the motion is late."""

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
