"""A sensor, or the filter behind it, that follows late."""

from __future__ import annotations

import numpy as np

from cablesense_sim.effects.effect import (
    WHOLE_ARM,
    Array,
    Effect,
    Parameter,
    Values,
    cables,
    chosen,
)
from cablesense_sim.effects.sensing import Sensing


class SensorLag(Effect):
    """A first-order lag, which starts settled; between samples the tension is held."""

    name = "sensor_lag"
    acts_on = "sensor"
    about = "a sensor or its filter that follows late"
    source = "Doebelin, Measurement Systems, 5th ed. 2003, section 3.3: first-order instruments"
    parameters = (
        Parameter("time_constant_s", "s", 0.0, 20.0, 0.3, "until 63 % of a step is read"),
    )

    def places(self, segment_count: int, cable_count: int) -> tuple[str, ...]:
        return (WHOLE_ARM, *cables(cable_count))

    def sensing(self, place: str, values: Values) -> Sensing:
        return _Lagging(place, values["time_constant_s"])


class _Lagging(Sensing):
    def __init__(self, place: str, time_constant_s: Array) -> None:
        self._place = place
        self._time_constant_s = np.maximum(time_constant_s, 1e-6)
        self._reading_n: Array | None = None
        self._time_s = 0.0

    def step(self, time_s: float, tensions_n: Array) -> Array:
        if self._reading_n is None:
            self._reading_n = tensions_n.copy()
        passed = max(time_s - self._time_s, 0.0)
        gain = -np.expm1(-passed / self._time_constant_s)[:, None]
        self._reading_n = self._reading_n + gain * (tensions_n - self._reading_n)
        self._time_s = time_s
        late = chosen(self._place, tensions_n.shape[-1])
        return np.where(late, self._reading_n, tensions_n)
