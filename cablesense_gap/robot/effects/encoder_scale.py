"""An encoder that counts too much."""

from __future__ import annotations

from cablesense_gap.robot.effects.effect import Effect, Parameter, Scale, Values, size
from cablesense_gap.robot.model import Change, Robot


class EncoderScale(Effect):
    """Positions that are too large by a share."""

    name = "encoder_scale"
    about = "an encoder with a wrong scale"
    advice = "Compare the gear ratio and the encoder's counts with the data sheet."
    in_model = False

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        return (size("share", "1", 0.5, 0.02, "read too much"),)

    def act(self, change: Change, at: int, values: Values) -> None:
        change.encoder_scale[at] += values["share"]
