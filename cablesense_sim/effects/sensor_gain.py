"""A wrong scale of a tension sensor."""

from __future__ import annotations

from cablesense_base.arrays import Array
from cablesense_sim.effects.effect import Effect, Parameter, Sensing, Values, cables, chosen


class SensorGain(Effect):
    """A sensor that reads all its tensions by the same share too high or too low."""

    name = "sensor_gain"
    acts_on = "sensor"
    about = "a wrong scale of tension sensors"
    source = "JCGM 200:2012 (VIM) 4.12, sensitivity of a measuring system"
    advice = "Hang known weights on these sensors and set their scale anew."
    order = -1
    parameters = (Parameter("gain", "1", -0.5, 0.5, 0.05, "share by which readings are too high"),)

    def places(self, segment_count: int, cable_count: int) -> tuple[str, ...]:
        return cables(cable_count)

    def sensing(self, place: str, values: Values) -> Sensing:
        return _Scaled(place, values["gain"])


class _Scaled(Sensing):
    def __init__(self, place: str, gain: Array) -> None:
        self._place, self._gain = place, gain

    def step(self, time_s: float, tensions_n: Array) -> Array:
        scale = 1.0 + self._gain[:, None] * chosen(self._place, tensions_n.shape[-1])
        return tensions_n * scale
