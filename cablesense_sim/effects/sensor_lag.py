"""A sensor, or the filter behind it, that follows late."""

from __future__ import annotations

import numpy as np

from cablesense_base import Array
from cablesense_sim.effects.effect import Effect, Parameter, Sensing, Values, chosen, shape


class SensorLag(Effect):
    """Two lags in a row, the second as slow as the first or faster; between samples tension holds.

    With a second share of nothing it is one first-order lag, with one it is critically damped of
    second order, as amplifiers' filters roughly are. It starts settled.
    """

    name = "sensor_lag"
    acts_on = "sensor"
    about = "tension sensors that follow late"
    source = "Doebelin, Measurement Systems, 5th ed. 2003, section 3.3: first and second order"
    sites = ("arm", "cable")
    advice = "Look at the filter settings of these channels; all should be alike."
    order = -2
    needs_time = True
    parameters = (
        Parameter("time_constant_s", "s", 0.0, 20.0, 0.3, "until 63 % of a step is through"),
        shape("second_share", "1", 0.0, 1.0, 0.5,
              "time constant of a second lag behind the first, of the first one's",
              starts=(0.0, 1.0)),
    )  # fmt: skip

    def sensing(self, place: str, values: Values) -> Sensing:
        return _Lagging(place, values["time_constant_s"], values["second_share"])


class _Lagging(Sensing):
    def __init__(self, place: str, time_constant_s: Array, second_share: Array) -> None:
        self._place = place
        self._first_s = np.maximum(time_constant_s, 1e-6)
        # equal lags are the limit of lags that differ by little
        self._share = np.clip(second_share, 1e-6, 1.0 - 1e-4)
        self._filtered_n: Array | None = None
        self._time_s = 0.0

    def step(self, time_s: float, tensions_n: Array) -> Array:
        if self._filtered_n is None:
            self._filtered_n = self._reading_n = tensions_n.copy()
        passed = max(time_s - self._time_s, 0.0)
        first = np.exp(-passed / self._first_s)[:, None]
        second = np.exp(-passed / (self._share * self._first_s))[:, None]
        behind_n = self._filtered_n - tensions_n
        across = (first - second) / (1.0 - self._share[:, None])
        self._reading_n = tensions_n + second * (self._reading_n - tensions_n) + across * behind_n
        self._filtered_n = tensions_n + first * behind_n
        self._time_s = time_s
        late = chosen(self._place, tensions_n.shape[-1])
        return np.where(late, self._reading_n, tensions_n)
