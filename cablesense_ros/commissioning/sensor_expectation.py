"""What readings of good sensors look like: by the arm file, or as a person asks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cablesense_sim.arm import Sensors
from cablesense_sim.sensors import reading_variance_n2

RATE_TOLERANCE = 0.05
JITTER_PERIODS = 0.5
"""From half a period on, a sample can be taken for its neighbour."""
LOST_SHARE = 0.001
NOISE_FACTOR = 2.0
"""Over what the arm file says; a loose screen or a motor nearby makes far more."""
STEP_FACTOR = 1.5
LEAST_FLOOR_N = 0.01
"""Of an arm file whose sensors are ideal."""
DRIFT_FLOORS = 4.0
"""So many standard deviations of a reading are noticed as a force by and by."""


@dataclass(frozen=True)
class SensorExpectation:
    """Bounds beside each figure.

    Attributes:
        rate_hz: of samples, to 5 %.
        floor_n: standard deviation of one reading at rest: noise, and the step's rounding.
        noise_n, step_n, drift_n: the most that is right; a step of 0 is not looked at.
        range_n: the ends at which a reading means nothing; none where unknown.
    """

    rate_hz: float
    floor_n: float
    noise_n: float
    step_n: float
    drift_n: float
    range_n: tuple[float, float] | None

    @property
    def jitter_s(self) -> float:
        """The most that is right."""
        return JITTER_PERIODS / self.rate_hz


def expectation(
    sensors: Sensors, rate_hz: float | None = None, drift_n: float | None = None
) -> SensorExpectation:
    """What an arm file expects of its sensors; rate and drift can be given instead."""
    floor_n = max(float(np.sqrt(reading_variance_n2(sensors))), LEAST_FLOOR_N)
    return SensorExpectation(
        rate_hz=sensors.rate_hz if rate_hz is None else rate_hz,
        floor_n=floor_n,
        noise_n=NOISE_FACTOR * floor_n,
        step_n=STEP_FACTOR * sensors.step_n,
        drift_n=DRIFT_FLOORS * floor_n if drift_n is None else drift_n,
        range_n=sensors.range_n,
    )
