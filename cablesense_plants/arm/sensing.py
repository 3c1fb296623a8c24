"""Readings of the plant's sensors: from faults of scale to noise and whole steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from cablesense_base import Array
from cablesense_plants.arm.body import NONE

DriftShape = Literal["linear", "slow sine", "random walk", "warm-up"]
Filter = Literal["first order", "moving average", "second order, critically damped"]

_FINE = 10
"""Samples of a filter between two readings."""


@dataclass(frozen=True)
class Dropouts:
    """Channels that repeat their last value for a while.

    Attributes:
        share: (M,) of the rows in which a channel does.
        mean_rows: how long a dropout lasts on average.
        seed: of when they come.
    """

    share: Array = NONE
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


@dataclass(frozen=True)
class Drift:
    """Drift of zeros, of one shape and different sizes.

    Attributes:
        size_n: (M,) how far each goes within a recording, either way.
        time_s: period of a sine, time constant of a warm-up.
        phase_rad: of the sine.
        seed: of the walk.
    """

    size_n: Array = NONE
    shape: DriftShape = "linear"
    time_s: float = 100.0
    phase_rad: float = 0.0
    seed: int = 0

    def zeros_n(self, time_s: Array) -> Array:
        """Zeros (R, M) at times (R,); (R, 1) where none drifts."""
        since = (time_s - time_s[0])[:, None]
        if not self.size_n.any():
            return np.zeros_like(since)
        if self.shape == "linear":
            shape = since / since[-1]
        elif self.shape == "slow sine":
            shape = np.sin(2.0 * np.pi * since / self.time_s + self.phase_rad)
        elif self.shape == "warm-up":
            shape = 1.0 - np.exp(-since / self.time_s)
        else:
            rng = np.random.default_rng(self.seed)
            walk = np.cumsum(rng.standard_normal((len(time_s), len(self.size_n))), axis=0)
            shape = (walk - walk[0]) / np.abs(walk - walk[0]).max(axis=0)
        return shape * self.size_n


@dataclass(frozen=True)
class SensorFaults:
    """Faults of M sensors, in the order in which a signal meets them; by default none.

    Attributes:
        bow_from_n: tension at which the nonlinearity is zero.
        gain: (M,) reading by tension.
        bow_per_n: (M,) nonlinearity: change of the gain with each newton above `bow_from_n`.
        ceiling_n: (M,) where a soft saturation sets in.
        leak: (M, M) share of the column's signal in the row's.
        lag_s: (M,) time constant, or half the window of an average.
        offset_n: (M,) zero errors.
        hum_n: (M,) amplitude of an interference of `hum_hz`.
        hum_phase_rad: (M,) its phase.
    """

    bow_from_n: float
    gain: Array = NONE + 1.0
    bow_per_n: Array = NONE
    ceiling_n: Array = NONE + np.inf
    leak: Array = NONE
    lag_s: Array = NONE
    lag_filter: Filter = "first order"
    offset_n: Array = NONE
    drift: Drift = Drift()
    hum_n: Array = NONE
    hum_hz: float = 0.3
    hum_phase_rad: Array = NONE
    dropouts: Dropouts = Dropouts()

    def signals_n(self, tension_n: Array, time_s: Array) -> Array:
        """(R, M) noise-free readings of tensions (R, M) at times (R,)."""
        signal = tension_n * (self.gain + self.bow_per_n * (tension_n - self.bow_from_n))
        over = np.maximum(signal - self.ceiling_n, 0.0)
        signal = np.where(over > 0.0, self.ceiling_n + over / (1.0 + over / 10.0), signal)
        if self.leak.any():
            signal = signal + signal @ self.leak.T
        signal = self._lagged(signal, time_s)
        hum = np.sin(2.0 * np.pi * self.hum_hz * time_s[:, None] + self.hum_phase_rad)
        signal = signal + self.offset_n + self.drift.zeros_n(time_s) + self.hum_n * hum
        return self.dropouts.repeated_n(signal)

    def _lagged(self, signal_n: Array, time_s: Array) -> Array:
        """Each column through its filter, settled at the first value before."""
        from scipy.signal import lfilter

        steps = len(time_s) - 1
        fine_s = np.interp(np.arange(steps * _FINE + 1) / _FINE, np.arange(steps + 1), time_s)
        period_s = float(fine_s[1] - fine_s[0])
        late = signal_n.copy()
        for column in np.flatnonzero(self.lag_s):
            fine = np.interp(fine_s, time_s, signal_n[:, column])
            if self.lag_filter == "moving average":
                fine = _averaged(fine, max(1.0, 2.0 * self.lag_s[column] / period_s))
            else:
                order = 1 if self.lag_filter == "first order" else 2
                kept = np.exp(-period_s / (self.lag_s[column] / order))
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


def read_n(signal_n: Array, noise_std_n: float, step_n: float, rng: np.random.Generator) -> Array:
    """Readings of signals: noise, then whole steps."""
    noisy = signal_n + noise_std_n * rng.standard_normal(signal_n.shape)
    return np.round(noisy / step_n) * step_n if step_n > 0.0 else noisy
