"""Readings of twelve good sensors at rest, for tests to spoil."""

from __future__ import annotations

import numpy as np

from cablesense_online.sensor_check import check_sensors, expectation
from cablesense_recording.recording import Recording
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
    """Them as a recording of one trial, without a load unless told otherwise."""
    rows = len(tensions_n)
    time_s = np.arange(rows) / RATE_HZ if time_s is None else time_s
    loaded = np.zeros(rows, dtype=np.int64) if at_rest is None else 1 - at_rest
    trial = np.zeros(rows, dtype=np.int64)
    still = np.zeros((rows, ARM.joint_count))
    return Recording("run", time_s, trial, still, loaded, np.zeros((rows, 3)), tensions_n)


def checked(recording, pulls=()):
    return check_sensors(recording, ARM.cable_names, EXPECTED, pulls)
