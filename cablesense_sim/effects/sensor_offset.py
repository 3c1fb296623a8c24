"""A constant zero error of a tension sensor."""

from __future__ import annotations

from cablesense_base import Array
from cablesense_sim.effects.effect import Effect, Instant, Parameter, Sensing, Values, chosen


class SensorOffset(Effect):
    """A sensor whose zero is wrong by more than the manufacturing tolerance."""

    name = "sensor_offset"
    acts_on = "sensor"
    about = "a constant zero error of tension sensors"
    source = "JCGM 200:2012 (VIM) 4.28, zero error of a measuring instrument"
    sites = ("cable",)
    advice = "Set the zero of these sensors with slack cables. A tare hides it from the estimator."
    parameters = (Parameter("offset_n", "N", -50.0, 50.0, 2.0, "what is read without a tension"),)

    def sensing(self, place: str, values: Values) -> Sensing:
        return shifted(place, values["offset_n"])


def shifted(place: str, offset_n: Array) -> Sensing:
    """A sensor that adds offsets (P,) to the readings of a place."""
    return Instant(lambda _, n: n + offset_n[:, None] * chosen(place, n.shape[-1]))
