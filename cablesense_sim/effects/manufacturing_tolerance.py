"""Manufacturing tolerance of cables and segments: no cause, but fitted beside every effect."""

from __future__ import annotations

from dataclasses import replace

from cablesense_sim.effects.effect import Effect, OneArm, Parameter, Sensing, Values, chosen
from cablesense_sim.effects.sensor_offset import shifted
from cablesense_sim.mechanism import Mechanism, with_cables_moved


class CableTolerance(Effect):
    """Scatter of pretensions, hole angles, zeros and friction."""

    name = "cable_tolerance"
    acts_on = "arm"
    about = "the manufacturing tolerance of a cable and its sensor"
    source = "ISO 2768-1, general tolerances, class m"
    sites = ("cable",)
    order = 1
    parameters = (
        Parameter("pretension_n", "N", -1.5, 1.5, 0.15, "of the pretension, in excess"),
        Parameter("angle_rad", "rad", -0.009, 0.009, 8.727e-4, "of its holes, turned"),
        Parameter("zero_n", "N", -0.5, 0.5, 0.05, "of the sensor's zero"),
        Parameter(
            "friction_share", "1", -0.9, 2.0, 0.1, "of the friction at its guides, in excess"
        ),
    )
    tolerance = True

    def amend(self, mechanism: Mechanism, place: str, values: OneArm) -> Mechanism:
        here = chosen(place, mechanism.cable_count)
        tensioned = mechanism.pretension_n + here * values["pretension_n"]
        friction = mechanism.relative_friction * (1.0 + here * values["friction_share"])
        mechanism = replace(mechanism, pretension_n=tensioned, relative_friction=friction)
        if not values["angle_rad"]:
            return mechanism
        return with_cables_moved(mechanism, 0.0 * here, here * values["angle_rad"])

    def sensing(self, place: str, values: Values) -> Sensing:
        return shifted(place, values["zero_n"])


class SegmentTolerance(Effect):
    """Scatter of masses and contact points."""

    name = "segment_tolerance"
    acts_on = "arm"
    about = "the manufacturing tolerance of a segment"
    source = "ISO 2768-1, general tolerances, class m"
    sites = ("segment",)
    order = 1
    parameters = (
        Parameter("mass_share", "1", -0.05, 0.05, 0.005, "of the mass, in excess"),
        Parameter("contact_m", "m", -0.003, 0.003, 0.0003, "of the contact point, outward"),
    )
    tolerance = True

    def amend(self, mechanism: Mechanism, place: str, values: OneArm) -> Mechanism:
        here = chosen(place, mechanism.segment_count)
        return replace(
            mechanism,
            mass_kg=mechanism.mass_kg * (1.0 + here * values["mass_share"]),
            contact_m=mechanism.contact_m + here * values["contact_m"],
        )
