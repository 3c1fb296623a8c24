"""What a careful workshop leaves open of a cable."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from cablesense_sim.effects.effect import Effect, Parameter, Values, cables, chosen
from cablesense_sim.effects.sensor_offset import Shifted
from cablesense_sim.mechanism import Mechanism, with_cables_moved


class CableTolerance(Effect):
    """Scatter of pretensions, hole angles and zeros; no finding, but fitted beside all."""

    name = "cable_tolerance"
    acts_on = "arm"
    about = "what a careful workshop leaves open of a cable and its sensor"
    source = "ISO 2768-1, general tolerances, class m"
    order = 1
    parameters = (
        Parameter("pretension_n", "N", -1.5, 1.5, 0.15, "of the pretension, in excess"),
        Parameter("angle_rad", "rad", -0.009, 0.009, 8.727e-4, "of its holes, turned"),
        Parameter("zero_n", "N", -0.5, 0.5, 0.05, "of the sensor's zero"),
    )
    tolerance = True

    def places(self, segment_count: int, cable_count: int) -> tuple[str, ...]:
        return cables(cable_count)

    def amend(self, mechanism: Mechanism, place: str, values: Mapping[str, float]) -> Mechanism:
        here = chosen(place, mechanism.cable_count)
        tensioned = mechanism.pretension_n + here * values["pretension_n"]
        mechanism = replace(mechanism, pretension_n=tensioned)
        if not values["angle_rad"]:
            return mechanism
        return with_cables_moved(mechanism, 0.0 * here, here * values["angle_rad"])

    def sensing(self, place: str, values: Values) -> Shifted:
        return Shifted(place, values["zero_n"])
