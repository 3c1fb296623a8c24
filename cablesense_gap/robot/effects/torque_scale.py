"""A motor whose torque constant is not the stated one."""

from __future__ import annotations

from cablesense_gap.robot.effects.effect import WHOLE_ARM, Effect, Parameter, Scale, Values, size
from cablesense_gap.robot.model import Change, Robot


class TorqueScale(Effect):
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
        own = slice(None) if at == len(change.torque_scale) else slice(at, at + 1)
        change.torque_scale[own] += values["share"]
