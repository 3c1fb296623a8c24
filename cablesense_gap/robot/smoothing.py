"""Positions smoothed with a stated bandwidth; their speeds and accelerations.

A Butterworth filter of third order, forwards and backwards: no lag, and a gain of
1 / (1 + (f / bandwidth)^6), that of a smoothing spline with a penalty on the third derivative.
Whatever is compared with smoothed motion goes through the same filter.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from scipy.signal import butter, sosfiltfilt, welch

from cablesense_base import Array

LEAST_HZ, MOST_HZ = 1.0, 20.0
"""Arms and their controllers are slower than this; faster ones state a bandwidth."""
SAMPLES = 8.0
"""Least number in a period at the bandwidth: derivatives are then good to 1 %."""
_SHARES = 40
_WINDOW_S = 10.0


def smoothed(signal: Array, rate_hz: float, bandwidth_hz: float) -> Array:
    """(T, …) of evenly sampled signals (T, …)."""
    if len(signal) < 8:
        return np.repeat(signal.mean(0, keepdims=True), len(signal), axis=0)
    most = len(signal) - 1
    pad = min(int(3.0 * rate_hz / bandwidth_hz), most)
    return np.asarray(sosfiltfilt(_sections(rate_hz, bandwidth_hz), signal, axis=0, padlen=pad))


@lru_cache
def _sections(rate_hz: float, bandwidth_hz: float) -> Array:
    return np.asarray(butter(3, bandwidth_hz, fs=rate_hz, output="sos"))


def derivatives(signal: Array, rate_hz: float) -> tuple[Array, Array]:
    """First and second time derivatives (T, J) of smoothed signals (T, J), by five points."""
    padded = np.concatenate([signal[[0, 0]], signal, signal[[-1, -1]]])
    a, b, c, d, e = (padded[k : k + len(signal)] for k in range(5))
    first = (a - 8.0 * b + 8.0 * d - e) * (rate_hz / 12.0)
    second = (-a + 16.0 * b - 30.0 * c + 16.0 * d - e) * (rate_hz**2 / 12.0)
    return first, second


def mean_spectrum(signals: Sequence[Array], rate_hz: float) -> tuple[Array, Array]:
    """Frequencies (F,) and power densities (F, J) of signals (T, J), over all of them."""
    count = min(int(np.median([len(s) for s in signals])), int(_WINDOW_S * rate_hz))
    every = [s for s in signals if len(s) >= count]
    found = [welch(s, rate_hz, nperseg=count, axis=0, detrend="constant") for s in every]
    return found[0][0], np.asarray(np.mean([density for _, density in found], axis=0))


def noise_density(
    signal: Array, rate_hz: float, above_hz: float, below_hz: float = np.inf
) -> Array:
    """(J,) power by hertz of what signals (T, J) have above a frequency, its median.

    Motion and its torques end below that frequency. The rest is noise; white noise has the same
    density below.
    """
    count = min(len(signal), max(64, int(_SHARES * rate_hz / above_hz)))
    frequency, density = welch(signal, rate_hz, nperseg=count, axis=0, detrend="linear")
    beyond = (frequency >= min(above_hz, 0.7 * frequency[-1])) & (frequency <= below_hz)
    return np.asarray(np.median(density[beyond], axis=0) / np.log(2.0))


def noise_of_acceleration(density: Array, *bandwidths_hz: float) -> Array:
    """Standard deviation that positions' white noise leaves in accelerations, smoothed."""
    frequency, through = _through(bandwidths_hz)
    power = ((2.0 * np.pi * frequency) ** 4 * through).sum() * frequency[1]
    return np.asarray(np.sqrt(density * power))


def noise_of_smoothed(density: Array, *bandwidths_hz: float) -> Array:
    """Standard deviation of white noise after filters of some bandwidths."""
    frequency, through = _through(bandwidths_hz)
    return np.asarray(np.sqrt(density * through.sum() * frequency[1]))


def noise_of_drift(density: Array, over_s: float, bandwidth_hz: float) -> tuple[Array, Array]:
    """The error that white noise of positions causes in free motion from a smoothed state.

    Free motion starts at the first state and is compared with the last one. The result has the
    standard deviations of position and speed.
    """
    frequency, through = _through([bandwidth_hz])
    w = 2.0 * np.pi * frequency
    later = np.exp(1j * w * over_s) - 1.0
    gains = np.abs(later - 1j * w * over_s) ** 2, w**2 * np.abs(later) ** 2
    of_position, of_speed = ((through * gain).sum() * frequency[1] for gain in gains)
    return np.sqrt(density * of_position), np.sqrt(density * of_speed)


def _through(bandwidths_hz: Sequence[float]) -> tuple[Array, Array]:
    frequency = np.linspace(0.0, 6.0 * max(bandwidths_hz), 2000)
    gains = [1.0 / (1.0 + (frequency / each) ** 6) for each in bandwidths_hz]
    return frequency, np.asarray(np.prod(gains, axis=0) ** 2)
