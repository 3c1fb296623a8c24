"""Mass that nobody modelled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cablesense_sim.effects.effect import Effect, OneArm, Parameter, chosen, shape
from cablesense_sim.mechanism import Mechanism


class Payload(Effect):
    """A point mass on a segment's axis: a tool, a camera, a hose."""

    name = "payload"
    acts_on = "arm"
    about = "mass that nobody modelled"
    source = "Featherstone, Rigid Body Dynamics Algorithms, 2008, section 2.13"
    sites = ("segment",)
    advice = "Weigh what was added there: tools, hoses, covers."
    parameters = (
        Parameter("mass_kg", "kg", -0.5, 10.0, 0.3, "of what the segment carries besides"),
        shape("beyond_middle", "1", -0.5, 0.5, 0.3,
              "its distance beyond the segment's middle, as a share of the segment's length"),
    )  # fmt: skip

    def amend(self, mechanism: Mechanism, place: str, values: OneArm) -> Mechanism:
        here = chosen(place, mechanism.segment_count)
        mass = mechanism.mass_kg + here * values["mass_kg"]
        moment = mechanism.mass_kg * mechanism.centre_of_mass_m + here * (
            values["mass_kg"] * (0.5 + values["beyond_middle"]) * mechanism.segment_length_m
        )
        heavy = np.maximum(mass, 1e-9)
        return replace(mechanism, mass_kg=heavy, centre_of_mass_m=moment / heavy)
