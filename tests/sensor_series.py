"""Readings of twelve good sensors at rest, for tests to spoil."""

from __future__ import annotations

import numpy as np

from cablesense_online.commissioning.sensor_check import TensionSeries, expectation
from cablesense_sim.arm import open_arm

ARM = open_arm("cdsm")
EXPECTED = expectation(ARM.sensors)
STEP_N = ARM.sensors.step_n
RATE_HZ = ARM.sensors.rate_hz


def good_tensions_n(seconds=10.0, seed=1):
    """(R, 12) readings at the arm's rate, with the noise and step of its file."""
    draw = np.random.default_rng(seed)
    true_n = 50.0 + np.arange(12.0)
    read_n = true_n + draw.normal(0.0, ARM.sensors.noise_std_n, (int(seconds * RATE_HZ), 12))
    return STEP_N * np.round(read_n / STEP_N)


def series(tensions_n, time_s=None, at_rest=None):
    """Them as a series of one block, at rest unless told otherwise."""
    rows = len(tensions_n)
    return TensionSeries(
        ARM.cable_names,
        np.arange(rows) / RATE_HZ if time_s is None else time_s,
        np.zeros(rows, dtype=np.int64),
        np.ones(rows, dtype=bool) if at_rest is None else at_rest,
        tensions_n,
    )
