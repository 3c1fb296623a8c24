"""What a careful workshop leaves open of a segment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from cablesense_sim.effects.effect import Effect, Parameter, chosen, segments
from cablesense_sim.mechanism import Mechanism


class SegmentTolerance(Effect):
    """Scatter of masses and contact points; no finding, but fitted beside every effect."""

    name = "segment_tolerance"
    acts_on = "arm"
    about = "what a careful workshop leaves open of a segment"
    source = "ISO 2768-1, general tolerances, class m"
    order = 1
    parameters = (
        Parameter("mass_share", "1", -0.05, 0.05, 0.005, "of the mass, in excess"),
        Parameter("contact_m", "m", -0.003, 0.003, 0.0003, "of the contact point, outward"),
    )
    tolerance = True

    def places(self, segment_count: int, cable_count: int) -> tuple[str, ...]:
        return segments(segment_count)

    def amend(self, mechanism: Mechanism, place: str, values: Mapping[str, float]) -> Mechanism:
        here = chosen(place, mechanism.segment_count)
        return replace(
            mechanism,
            mass_kg=mechanism.mass_kg * (1.0 + here * values["mass_share"]),
            contact_m=mechanism.contact_m + here * values["contact_m"],
        )
