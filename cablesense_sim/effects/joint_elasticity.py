"""Joints that spring back."""

from __future__ import annotations

from dataclasses import replace

from cablesense_sim.effects.effect import Effect, OneArm, Parameter, chosen
from cablesense_sim.mechanism import Mechanism


class JointElasticity(Effect):
    """A spring in both axes of a joint, at rest where the arm is straight: a sheath, a bundle."""

    name = "joint_elasticity"
    acts_on = "arm"
    about = "joints that spring back"
    source = "Spong, Modeling and control of elastic joint robots, ASME JDSMC 1987"
    sites = ("arm", "joint")
    advice = "Look for a sheath, a hose or a bundle through the middle of the arm."
    parameters = (Parameter("stiffness_n_m_rad", "N·m/rad", -20.0, 200.0, 5.0, "of each axis"),)

    def amend(self, mechanism: Mechanism, place: str, values: OneArm) -> Mechanism:
        spring = chosen(place, mechanism.segment_count) * values["stiffness_n_m_rad"]
        return replace(
            mechanism, joint_stiffness_n_m_rad=mechanism.joint_stiffness_n_m_rad + spring
        )
