"""A base that is not level."""

from __future__ import annotations

from dataclasses import replace

from scipy.spatial.transform import Rotation

from cablesense_sim.effects.effect import Effect, OneArm, Parameter
from cablesense_sim.mechanism import Mechanism


class BaseTilt(Effect):
    """Gravity that points elsewhere in the base frame; loads are known in the base frame."""

    name = "base_tilt"
    acts_on = "arm"
    about = "a base that is not level"
    source = "Siciliano et al., Robotics: Modelling, Planning and Control, 2009, section 7.3"
    advice = "Put a level on the base; level it, or keep the tilt in the arm file."
    parameters = (
        Parameter("roll_rad", "rad", -0.6, 0.6, 0.05, "of the base about its x axis"),
        Parameter("pitch_rad", "rad", -0.6, 0.6, 0.05, "of the base about its y axis"),
    )

    def amend(self, mechanism: Mechanism, place: str, values: OneArm) -> Mechanism:
        tilt = Rotation.from_euler("yx", [values["pitch_rad"], values["roll_rad"]])
        return replace(mechanism, gravity_m_s2=tilt.inv().apply(mechanism.gravity_m_s2))
