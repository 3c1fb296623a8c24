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
    passed_s: Array | float, time_constant_s: Array, second_share: Array
) -> tuple[Array, Array, Array]:
    """What is left after a time: of either lag's own gap, and of the first's behind.

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
        return self.along(np.array([time_s]), tensions_n[:, None])[:, 0]

    def along(self, time_s: Array, tensions_n: Array) -> Array:
        if self._filtered_n is None:
            self._filtered_n = self._reading_n = tensions_n[:, 0]
        passed = np.maximum(np.diff(time_s, prepend=self._time_s), 0.0)
        lags = (lag[:, None] for lag in self._lags)
        first, second, across = (share[..., None] for share in lag_shares(passed, *lags))
        filtered = _low_passed(first, (1.0 - first) * tensions_n, self._filtered_n)
        before = np.concatenate([self._filtered_n[:, None], filtered[:, :-1]], axis=1)
        added = (1.0 - second) * tensions_n + across * (before - tensions_n)
        reading = _low_passed(second, added, self._reading_n)
        self._filtered_n, self._reading_n = filtered[:, -1], reading[:, -1]
        self._time_s = float(time_s[-1])
        return np.where(chosen(self._place, tensions_n.shape[-1]), reading, tensions_n)


def _low_passed(kept: Array, added: Array, start: Array) -> Array:
    """y_r = kept_r y_(r-1) + added_r along the second axis of (P, R, M), from `start` (P, M) on.

    Rows of twice as many steps at a time: Hillis and Steele, Data parallel algorithms, CACM 1986.
    """
    kept, found = np.broadcast_to(kept, added.shape).copy(), added.copy()
    found[:, 0] += kept[:, 0] * start
    step = 1
    while step < found.shape[1]:
        found[:, step:] += kept[:, step:] * found[:, :-step]
        kept[:, step:] *= kept[:, :-step].copy()
        step *= 2
    return found
