"""What the plant's sensors make of tensions: from faults of scale to noise and whole steps."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from cablesense_base.arrays import Array

_FINE = 10
"""Samples of a filter between two readings."""


@dataclass(frozen=True)
class Dropouts:
    """Dropouts of M channels.

    Attributes:
        share: (M,) of the rows in which a channel repeats its last value.
        mean_rows: how long a dropout lasts on average.
        seed: of when they come.
    """

    share: Array
    mean_rows: float = 20.0
    seed: int = 0

    def repeated_n(self, signal_n: Array) -> Array:
        """(R, M) signals, through each dropout the last value before it."""
        if not self.share.any():
            return signal_n
        rng = np.random.default_rng(self.seed)
        rows = len(signal_n)
        last = np.tile(np.arange(rows)[:, None], (1, len(self.share)))
        for channel in np.flatnonzero(self.share):
            gap = self.mean_rows * (1.0 / self.share[channel] - 1.0)
            at = 1.0 + rng.exponential(gap)
            while at < rows:
                end = at + 1.0 + rng.exponential(self.mean_rows)
                last[int(at) : int(end), channel] = int(at) - 1
                at = end + 1.0 + rng.exponential(gap)
        return np.take_along_axis(signal_n, last, axis=0)


class DriftShape(StrEnum):
    """How a zero drifts."""

    LINEAR = "linear"
    SINE = "slow sine"
    WALK = "random walk"
    WARM_UP = "warm-up"


@dataclass(frozen=True)
class Drift:
    """Drift of the zeros of M sensors, of one shape and different sizes.

    Attributes:
        size_n: (M,) how far each goes within a recording, either way.
        shape: over time.
        time_s: period of a sine, time constant of a warm-up.
        phase_rad: of the sine.
        seed: of the walk.
    """

    size_n: Array
    shape: DriftShape = DriftShape.LINEAR
    time_s: float = 100.0
    phase_rad: float = 0.0
    seed: int = 0

    def zeros_n(self, time_s: Array) -> Array:
        """(R, M) zeros at times (R,)."""
        if not self.size_n.any():
            return np.zeros((len(time_s), len(self.size_n)))
        since = time_s - time_s[0]
        match self.shape:
            case DriftShape.LINEAR:
                shape = since[:, None] / since[-1] * np.ones_like(self.size_n)
            case DriftShape.SINE:
                shape = np.sin(2.0 * np.pi * since / self.time_s + self.phase_rad)[:, None]
            case DriftShape.WARM_UP:
                shape = 1.0 - np.exp(-since / self.time_s)[:, None]
            case DriftShape.WALK:
                rng = np.random.default_rng(self.seed)
                walk = np.cumsum(rng.standard_normal((len(time_s), len(self.size_n))), axis=0)
                shape = (walk - walk[0]) / np.abs(walk - walk[0]).max(axis=0)
        return shape * self.size_n


class Filter(StrEnum):
    """What delays a sensor."""

    FIRST_ORDER = "first order"
    MOVING_AVERAGE = "moving average"
    CRITICAL = "second order, critically damped"


@dataclass(frozen=True)
class Sensing:
    """Faults of M sensors, in the order in which a signal meets them.

    Attributes:
        gain: (M,) reading by tension.
        bow_per_n: (M,) nonlinearity: change of the gain with each newton above the pretension.
        ceiling_n: (M,) where a soft saturation sets in.
        leak: (M, M) share of the column's signal in the row's.
        lag_s: (M,) time constant, or half the window of an average.
        offset_n: (M,) zero errors.
        hum_n: (M,) amplitude of an interference of `hum_hz`.
        hum_phase_rad: (M,) its phase.
        bow_from_n: tension at which the nonlinearity is zero.
    """

    gain: Array
    bow_per_n: Array
    ceiling_n: Array
    leak: Array
    lag_s: Array
    offset_n: Array
    drift: Drift
    hum_n: Array
    hum_phase_rad: Array
    dropouts: Dropouts
    bow_from_n: float
    lag_filter: Filter = Filter.FIRST_ORDER
    hum_hz: float = 0.3

    def signals_n(self, tension_n: Array, time_s: Array) -> Array:
        """(R, M) noise-free readings of tensions (R, M) at times (R,)."""
        signal = tension_n * (self.gain + self.bow_per_n * (tension_n - self.bow_from_n))
        over = np.maximum(signal - self.ceiling_n, 0.0)
        signal = np.where(over > 0.0, self.ceiling_n + over / (1.0 + over / 10.0), signal)
        signal = signal + signal @ self.leak.T
        signal = _lagged(signal, time_s, self.lag_s, self.lag_filter)
        hum = np.sin(2.0 * np.pi * self.hum_hz * time_s[:, None] + self.hum_phase_rad)
        signal = signal + self.offset_n + self.drift.zeros_n(time_s) + self.hum_n * hum
        return self.dropouts.repeated_n(signal)


def ideal_sensing(cables: int, pretension_n: float) -> Sensing:
    """Sensors without faults."""
    zero = np.zeros(cables)
    return Sensing(
        gain=zero + 1.0,
        bow_per_n=zero,
        ceiling_n=zero + np.inf,
        leak=np.zeros((cables, cables)),
        lag_s=zero,
        offset_n=zero,
        drift=Drift(zero),
        hum_n=zero,
        hum_phase_rad=zero,
        dropouts=Dropouts(zero),
        bow_from_n=pretension_n,
    )


def read_n(signal_n: Array, noise_std_n: float, step_n: float, rng: np.random.Generator) -> Array:
    """Readings of signals: noise, then whole steps."""
    noisy = signal_n + noise_std_n * rng.standard_normal(signal_n.shape)
    return np.round(noisy / step_n) * step_n if step_n > 0.0 else noisy


def _lagged(signal_n: Array, time_s: Array, lag_s: Array, kind: Filter) -> Array:
    """Each column through its filter, settled at the first value before."""
    if not lag_s.any():
        return signal_n
    from scipy.signal import lfilter

    steps = len(time_s) - 1
    fine_s = np.interp(np.arange(steps * _FINE + 1) / _FINE, np.arange(steps + 1), time_s)
    period_s = float(fine_s[1] - fine_s[0])
    late = signal_n.copy()
    for column in np.flatnonzero(lag_s):
        fine = np.interp(fine_s, time_s, signal_n[:, column])
        if kind is Filter.MOVING_AVERAGE:
            fine = _averaged(fine, max(1.0, 2.0 * lag_s[column] / period_s))
        else:
            order = 1 if kind is Filter.FIRST_ORDER else 2
            kept = np.exp(-period_s / (lag_s[column] / order))
            for _stage in range(order):
                fine, _ = lfilter([1.0 - kept], [1.0, -kept], fine, zi=[kept * fine[0]])
        late[:, column] = fine[::_FINE]
    return late


def _averaged(signal: Array, window: float) -> Array:
    """Mean over the last `window` samples, which need not be a whole number."""
    whole = int(np.ceil(window))
    total = np.concatenate([[0.0], np.cumsum(np.pad(signal, (whole, 0), mode="edge"))])
    ends = whole + np.arange(1, len(signal) + 1)
    starts = np.interp(ends - window, np.arange(len(total)), total)
    return (total[ends] - starts) / window
