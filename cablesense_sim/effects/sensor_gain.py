"""A wrong scale of a tension sensor."""

from __future__ import annotations

from cablesense_base import Array
from cablesense_sim.effects.effect import Effect, Instant, Parameter, Sensing, Values, chosen


class SensorGain(Effect):
    """A sensor that reads all its tensions by the same share too high or too low."""

    name = "sensor_gain"
    acts_on = "sensor"
    about = "a wrong scale of tension sensors"
    source = "JCGM 200:2012 (VIM) 4.12, sensitivity of a measuring system"
    sites = ("cable",)
    advice = "Hang known weights on these sensors and set their scale anew."
    order = -1
    parameters = (Parameter("gain", "1", -0.5, 0.5, 0.05, "share by which readings are too high"),)

    def sensing(self, place: str, values: Values) -> Sensing:
        def scaled(_: float | Array, tensions_n: Array) -> Array:
            here = chosen(place, tensions_n.shape[-1])
            return tensions_n * (1.0 + values["gain"][:, None] * here)

        return Instant(scaled)
