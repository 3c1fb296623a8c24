"""A constant zero error of a tension sensor."""

from __future__ import annotations

from cablesense_base.arrays import Array
from cablesense_sim.effects.effect import Effect, Parameter, Sensing, Values, cables, chosen


class SensorOffset(Effect):
    """A sensor whose zero is wrong by more than the manufacturing tolerance."""

    name = "sensor_offset"
    acts_on = "sensor"
    about = "a constant zero error of tension sensors"
    source = "JCGM 200:2012 (VIM) 4.28, zero error of a measuring instrument"
    advice = "Set the zero of these sensors with slack cables. A tare hides it from the estimator."
    parameters = (Parameter("offset_n", "N", -50.0, 50.0, 2.0, "what is read without a tension"),)

    def places(self, segment_count: int, cable_count: int) -> tuple[str, ...]:
        return cables(cable_count)

    def sensing(self, place: str, values: Values) -> Sensing:
        return Shifted(place, values["offset_n"])


class Shifted(Sensing):
    """Adds offsets (P,) to the readings of a place."""

    def __init__(self, place: str, offset_n: Array) -> None:
        self._place, self._offset_n = place, offset_n

    def step(self, time_s: float, tensions_n: Array) -> Array:
        return tensions_n + self._offset_n[:, None] * chosen(self._place, tensions_n.shape[-1])
