"""Cables softer or harder than nominal."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cablesense_sim.effects.effect import Effect, OneArm, Parameter, own_cables
from cablesense_sim.mechanism import Mechanism


class CableStiffness(Effect):
    """Another stiffness from command to anchor, of all cables or of those of one segment."""

    name = "cable_stiffness"
    acts_on = "arm"
    about = "cables of another stiffness than stated"
    source = "Feyrer, Wire Ropes, 2nd ed. 2015, section 2.2: rope elasticity modulus"
    sites = ("arm", "segment")
    advice = (
        "Measure a cable's stiffness on a bench, from command to anchor; look for another "
        "kind or length of cable, and for a soft anchor."
    )
    parameters = (
        Parameter("change", "1", -0.8, 3.0, 0.2, "share by which the stiffness is higher",
                  relative=True),
    )  # fmt: skip

    def amend(self, mechanism: Mechanism, place: str, values: OneArm) -> Mechanism:
        scale = np.where(own_cables(place, mechanism), 1.0 + values["change"], 1.0)
        in_series = mechanism.stiffness_n_m * scale
        cable = 1.0 / (1.0 / in_series - 1.0 / mechanism.actuator_stiffness_n_m)
        return replace(mechanism, stiffness_n_m=in_series, cable_stiffness_n_m=cable)
