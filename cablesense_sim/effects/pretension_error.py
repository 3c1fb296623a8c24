"""Cables tensioned to another value."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cablesense_sim.effects.effect import Effect, OneArm, Parameter, chosen
from cablesense_sim.mechanism import Mechanism


class PretensionError(Effect):
    """Cables whose tension, with the arm held straight, was set to another value.

    The arm moves until it is balanced again, so a single wrong cable changes all the others.
    """

    name = "pretension_error"
    acts_on = "arm"
    about = "cables tensioned to another value"
    source = "Pott, Cable-Driven Parallel Robots, 2018, section 3.7: force distribution"
    sites = ("arm", "cable")
    advice = "Tension these cables anew with the arm straight, or keep the values in the arm file."
    parameters = (
        Parameter("error_n", "N", -45.0, 200.0, 5.0, "by which the pretension is higher"),
    )

    def amend(self, mechanism: Mechanism, place: str, values: OneArm) -> Mechanism:
        error = chosen(place, mechanism.cable_count) * values["error_n"]
        pretension = np.maximum(mechanism.pretension_n + error, 0.1)
        return replace(mechanism, pretension_n=pretension)
