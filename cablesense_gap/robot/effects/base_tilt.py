"""A base that is not level."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from cablesense_gap.robot.effects.effect import WHOLE_ARM, Effect, Parameter, Scale, Values, size
from cablesense_gap.robot.model import Change, Robot


class BaseTilt(Effect):
    """Gravity points elsewhere in the base frame: the base is turned about its axes."""

    name = "base_tilt"
    about = "a base that is not level"
    advice = "Put a level on the base."

    def places(self, robot: Robot) -> tuple[str, ...]:
        return (WHOLE_ARM,)

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        """About the axes that are not gravity's own."""
        along = np.abs(robot.model.opt.gravity)
        return tuple(
            size(f"about_{axis}_rad", "rad", 0.6, 0.03, f"the base turned about its {axis}")
            for axis, share in zip("xyz", along / max(along.max(), 1e-9), strict=True)
            if share < 1.0
        )

    def act(self, change: Change, at: int, values: Values) -> None:
        turned = Rotation.from_rotvec([values[f"about_{axis}_rad"] for axis in "xyz"])
        change.gravity_m_s2 = turned.inv().apply(change.gravity_m_s2)
