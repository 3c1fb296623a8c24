"""The tension sensors at the actuator ends: Gaussian noise, then the converter's step."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from cablesense_base.arrays import Array
from cablesense_sim.arm import Sensors


def read_tensions_n(tensions_n: ArrayLike, sensors: Sensors, rng: np.random.Generator) -> Array:
    """Readings of tensions of any shape, N: noise, rounding to the step, held to the range."""
    reading = np.asarray(tensions_n, dtype=float)
    if sensors.noise_std_n > 0.0:
        reading = reading + rng.normal(0.0, sensors.noise_std_n, reading.shape)
    if sensors.step_n > 0.0:
        reading = np.round(reading / sensors.step_n) * sensors.step_n
    if sensors.range_n is not None:
        reading = np.clip(reading, *sensors.range_n)
    return reading


def reading_variance_n2(sensors: Sensors) -> float:
    """Variance of one reading, N²: noise, and rounding uniform over one step (step² / 12)."""
    return sensors.noise_std_n**2 + sensors.step_n**2 / 12.0


def difference_variance_n2(sensors: Sensors, tare_samples: int) -> float:
    """Variance of a reading less the mean of `tare_samples` unloaded ones, N²."""
    return reading_variance_n2(sensors) * (1.0 + 1.0 / tare_samples)
