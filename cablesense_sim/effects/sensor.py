"""Effects of sensors: a recording differs from the tensions and loads that acted."""

from __future__ import annotations

import numpy as np

from cablesense_base import Array
from cablesense_sim.effects.effect import (
    WHOLE_ARM,
    Effect,
    Instant,
    Parameter,
    Sensing,
    Values,
    chosen,
    shape,
    shifted,
)
from cablesense_sim.rotations import rotation_matrix


class SensorOffset(Effect):
    """A sensor whose zero is wrong by more than the manufacturing tolerance."""

    name = "sensor_offset"
    acts_on = "sensor"
    about = "a constant zero error of tension sensors"
    source = "JCGM 200:2012 (VIM) 4.28, zero error of a measuring instrument"
    sites = ("cable",)
    advice = "Set the zero of these sensors with slack cables. A tare hides it from the estimator."
    parameters = (Parameter("offset_n", "N", -50.0, 50.0, 2.0, "reading without a tension"),)

    def sensing(self, place: str, values: Values) -> Sensing:
        return shifted(place, values["offset_n"])


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
            affected = chosen(place, tensions_n.shape[-1])
            return tensions_n * (1.0 + values["gain"][:, None] * affected)

        return Instant(scaled)


class SensorCrosstalk(Effect):
    """Readings of one channel that carry a share of another's tension.

    At the place `arm`, every channel leaks into its two neighbours.
    """

    name = "sensor_crosstalk"
    acts_on = "sensor"
    about = "crosstalk between tension sensors"
    source = "Doebelin, Measurement Systems, 5th ed. 2003, chapter 2: interfering inputs"
    advice = "Look at shared wiring, ground and amplifier of these channels."
    order = -3
    parameters = (
        Parameter("share", "1", -0.3, 0.3, 0.03, "share of the other channel's tension"),
    )

    def places(self, segment_count: int, cable_count: int) -> tuple[str, ...]:
        numbers = range(1, cable_count + 1)
        pairs = (f"cable_{a}_into_cable_{b}" for a in numbers for b in numbers if a != b)
        return (WHOLE_ARM, *pairs)

    def sensing(self, place: str, values: Values) -> Sensing:
        def leaking(_: float | Array, tensions_n: Array) -> Array:
            readings = tensions_n.copy()
            share = values["share"]
            if place == WHOLE_ARM:
                readings[..., 1:] += share[:, None] * tensions_n[..., :-1]
                readings[..., :-1] += share[:, None] * tensions_n[..., 1:]
            else:
                source, target = (int(p.rsplit("_", 1)[1]) - 1 for p in place.split("_into_"))
                readings[..., target] += share * tensions_n[..., source]
            return readings

        return Instant(leaking)


INTERVAL_S = 30.0
"""The zero moves at an even pace within such an interval."""

_INTERVALS = 10
"""Of `INTERVAL_S`: the five minutes that a recording of the usual protocol takes."""


class SensorDrift(Effect):
    """A sensor whose zero moves, by another amount in each half minute; then it stands still.

    Equal independent rises make a random walk, the usual model of a zero (IEEE Std 1293-2018). It
    begins where it is: a zero that is wrong from the first sample on is a `sensor_offset`.
    """

    name = "sensor_drift"
    acts_on = "sensor"
    about = "a zero of tension sensors that wanders"
    source = "IEEE Std 1293-2018, annex on bias instability and random walk"
    sites = ("cable",)
    advice = "Let the sensors warm up; look at their supply and cabling; tare often."
    needs_time = True
    version = 2  # before, it had a zero error at the beginning, and imitated an offset
    parameters = tuple(
        Parameter(
            f"rise_{k + 1}_n",
            "N",
            -20.0,
            20.0,
            0.7,
            f"movement of the zero from {k * INTERVAL_S:g} to {(k + 1) * INTERVAL_S:g} s",
        )
        for k in range(_INTERVALS)
    )

    def sensing(self, place: str, values: Values) -> Sensing:
        rises_n = np.stack([values[p.name] for p in self.parameters], axis=-1)

        def wandering(time_s: float | Array, tensions_n: Array) -> Array:
            passed = np.asarray(time_s)[..., None] / INTERVAL_S
            done = np.clip(passed - np.arange(_INTERVALS), 0.0, 1.0)
            drift_n = (done @ rises_n.T)[..., None]
            return tensions_n + drift_n * chosen(place, tensions_n.shape[-1])

        return Instant(wandering)


class SensorLag(Effect):
    """Two lags in a row, the second as slow as the first or faster.

    With a second share of zero it is one first-order lag. With a share of one it is critically
    damped of second order, roughly as filters of amplifiers are. It starts settled. Tensions
    change linearly from sample to sample, so rows may be left out where they do.
    """

    name = "sensor_lag"
    version = 2
    acts_on = "sensor"
    about = "tension sensors that follow late"
    source = "Doebelin, Measurement Systems, 5th ed. 2003, section 3.3: first and second order"
    sites = ("arm", "cable")
    advice = "Look at the filter settings of these channels; all should be alike."
    order = -2
    needs_time = True
    parameters = (
        Parameter(
            "time_constant_s",
            "s",
            0.0,
            20.0,
            0.3,
            "until 63 % of a step is through",
            starts=(0.3, 3.0),  # shorter and longer than loads rise: its change is far from linear
        ),
        shape(
            "second_share",
            "1",
            0.0,
            1.0,
            0.5,
            "time constant of a second lag behind the first, of the first one's",
            starts=(0.0, 1.0),
        ),
    )

    def sensing(self, place: str, values: Values) -> Sensing:
        first_s = np.maximum(values["time_constant_s"], 1e-6)
        # equal lags are the limit of lags that differ by little
        return _Lagging(place, first_s, np.clip(values["second_share"], 1e-6, 1.0 - 1e-4))


class _Lagging(Sensing):
    def __init__(self, place: str, first_s: Array, second_share: Array) -> None:
        self._place = place
        self._lags = first_s[:, None], second_share[:, None]
        self._tension_n: Array | None = None
        self._time_s = 0.0

    def step(self, time_s: float, values: Array) -> Array:
        return self.along(np.array([time_s]), values[:, None])[:, 0]

    def along(self, time_s: Array, values: Array) -> Array:
        if self._tension_n is None:
            self._tension_n = values[:, 0]
            self._filtered_n = self._tension_n
            self._reading_n = self._tension_n
        passed_s = np.maximum(np.diff(time_s, prepend=self._time_s), 1e-9)
        first, late, second, across, both_late = _lag_shares(passed_s, *self._lags)
        begin = np.concatenate([self._tension_n[:, None], values[:, :-1]], axis=1)
        added = (late - first) * begin + (1.0 - late) * values
        filtered = _low_passed(first, added, self._filtered_n)
        before = np.concatenate([self._filtered_n[:, None], filtered[:, :-1]], axis=1)
        added = (both_late - second) * begin + (1.0 - both_late) * values
        reading = _low_passed(second, added + across * (before - begin), self._reading_n)
        self._tension_n = values[:, -1]
        self._filtered_n = filtered[:, -1]
        self._reading_n = reading[:, -1]
        self._time_s = float(time_s[-1])
        return np.where(chosen(self._place, values.shape[-1]), reading, values)


def _lag_shares(passed_s: Array, first_s: Array, second_share: Array) -> list[Array]:
    """Shares (P, R, 1) of two lags in a row over steps (R,) in which the input changes linearly.

    They are: the share that the first lag keeps of its error at the start of a step; the share of
    the input's change by which it is late at the end; the share that the reading keeps of its
    error; its share of the first lag's error; and the share of the change by which it is late.
    """
    second_s = second_share * first_s
    first = np.exp(-passed_s / first_s)
    second = np.exp(-passed_s / second_s)
    across = (first - second) / (1.0 - second_share)
    late = first_s * (1.0 - first) / passed_s
    both_late = ((first_s + second_s) * (1.0 - second) - first_s * across) / passed_s
    return [share[..., None] for share in (first, late, second, across, both_late)]


def _low_passed(kept: Array, added: Array, start: Array) -> Array:
    """y_r = kept_r y_(r-1) + added_r along the second axis of (P, R, M), from `start` (P, M) on.

    Rows of twice as many steps at a time: Hillis and Steele, Data parallel algorithms, CACM 1986.
    """
    kept = np.broadcast_to(kept, added.shape).copy()
    filtered = added.copy()
    filtered[:, 0] += kept[:, 0] * start
    step = 1
    while step < filtered.shape[1]:
        filtered[:, step:] += kept[:, step:] * filtered[:, :-step]
        kept[:, step:] *= kept[:, :-step].copy()
        step *= 2
    return filtered


_TURN = "of the load that acts against the recorded one, about the base's {} axis"


class LoadCell(Effect):
    """A load cell of another scale, or turned against the base.

    It belongs to the recording: the arm itself and its sensors are as they should be.
    """

    name = "load_cell"
    acts_on = "load"
    about = "a load cell whose scale or axes are not as recorded"
    source = "Lynch and Park, Modern Robotics, 2017, section 3.4: a wrench in another frame"
    advice = (
        "Hang a known weight on the load cell; check how its axes stand against those of the "
        "base, in which loads are recorded."
    )
    parameters = (
        Parameter(
            "scale",
            "1",
            -0.6,
            1.0,
            0.02,
            "share by which the acting load is larger",
            relative=True,
        ),
        *(
            Parameter(f"turn_{axis}_rad", "rad", -0.8, 0.8, 0.03, _TURN.format(axis))
            for axis in "xyz"
        ),
    )

    def loading(self, place: str, values: Values) -> Array:
        turn = rotation_matrix(np.stack([values[f"turn_{a}_rad"] for a in "xyz"], axis=-1))
        return np.asarray((1.0 + values["scale"])[:, None, None] * turn)
