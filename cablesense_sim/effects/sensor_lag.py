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


def lag_shares(
    passed_s: float, time_constant_s: Array, second_share: Array
) -> tuple[Array, Array, Array]:
    """What is left, each (P,), after a time: of either lag's own gap, and of the first's behind.

    What the first lag has let through is behind by `first` of what it was; the reading by `second`
    of what it was, and `across` of what the first one was behind.
    """
    first_s = np.maximum(time_constant_s, 1e-6)
    # equal lags are the limit of lags that differ by little
    share = np.clip(second_share, 1e-6, 1.0 - 1e-4)
    first, second = np.exp(-passed_s / first_s), np.exp(-passed_s / (share * first_s))
    return first, second, (first - second) / (1.0 - share)


class _Lagging(Sensing):
    def __init__(self, place: str, time_constant_s: Array, second_share: Array) -> None:
        self._place = place
        self._lags = time_constant_s, second_share
        self._filtered_n: Array | None = None
        self._time_s = 0.0

    def step(self, time_s: float, tensions_n: Array) -> Array:
        if self._filtered_n is None:
            self._filtered_n = self._reading_n = tensions_n.copy()
        passed = max(time_s - self._time_s, 0.0)
        first, second, across = (share[:, None] for share in lag_shares(passed, *self._lags))
        behind_n = self._filtered_n - tensions_n
        self._reading_n = tensions_n + second * (self._reading_n - tensions_n) + across * behind_n
        self._filtered_n = tensions_n + first * behind_n
        self._time_s = time_s
        late = chosen(self._place, tensions_n.shape[-1])
        return np.where(late, self._reading_n, tensions_n)
