"""Friction where tendons run over guides."""

from __future__ import annotations

import mujoco
import numpy as np

from cablesense_gap.robot.effects.effect import (
    PRESLIDING,
    Effect,
    Parameter,
    Scale,
    Values,
    rms,
    size,
)
from cablesense_gap.robot.model import Change, Robot


class CapstanFriction(Effect):
    """Tensions on both sides of a guide are apart by at most exp(μ θ), θ as the model has it.

    A tendon turns by θ at each site or geom on its way. Its loss acts on every joint that it
    crosses beyond the guide, and comes with its own tension, pretension too.
    """

    name = "capstan_friction"
    about = "friction of a tendon over its guides"
    source = "Euler's and Eytelwein's law at each guide; see cablesense_sim.cable_chain"
    advice = "Look for worn, dry or kinked guides and sheaths of this tendon."
    in_model = False
    against_motion = True
    gives_forward = True
    withheld = False

    def places(self, robot: Robot) -> tuple[str, ...]:
        return robot.tendons

    def parameters(self, robot: Robot, scale: Scale) -> tuple[Parameter, ...]:
        data = mujoco.MjData(robot.model)
        mujoco.mj_fwdPosition(robot.model, data)
        give = 1e-2 * rms(scale.position) * float(np.abs(data.ten_J).max(initial=1e-6))
        about = "of cable given before it slips the other way"
        return (
            size("coefficient", "1", 1.5, 0.1, "of friction between tendon and guides", 0.0),
            Parameter(PRESLIDING, "m", 0.02 * give, 50.0 * give, give, about, give, role="shape"),
        )

    def act(self, change: Change, at: int, values: Values) -> None:
        change.capstan_friction[at] += values["coefficient"]
        change.capstan_presliding[at] = values[PRESLIDING]
