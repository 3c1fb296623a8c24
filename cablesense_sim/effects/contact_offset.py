"""Loads that act elsewhere along the segment than stated."""

from __future__ import annotations

from dataclasses import replace

from cablesense_sim.effects.effect import Effect, OneArm, Parameter, chosen
from cablesense_sim.mechanism import Mechanism


class ContactOffset(Effect):
    """Contact points further along one segment's axis, or along every segment's."""

    name = "contact_offset"
    acts_on = "arm"
    about = "loads that act elsewhere along the segment than stated"
    source = "Bicchi, Salisbury and Brock, Contact sensing from force measurements, IJRR 1993"
    sites = ("arm", "segment")
    advice = "Measure where the load was applied, from the segment's joint centre."
    parameters = (
        Parameter("offset_m", "m", -0.1, 0.1, 0.01, "of the contact point, away from the base"),
    )

    def amend(self, mechanism: Mechanism, place: str, values: OneArm) -> Mechanism:
        moved = chosen(place, mechanism.segment_count) * values["offset_m"]
        return replace(mechanism, contact_m=mechanism.contact_m + moved)
