"""What repeats with an angle or a length is found with its period, and nothing else is."""

from __future__ import annotations

import numpy as np
import pytest
from gap_recordings import LAB

from cablesense_gap.recordings.recording import Recording
from cablesense_gap.residual_patterns import periodic
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import held_lengths_m

FLOOR_N = 0.1
ROWS = 500
rng = np.random.default_rng(2)
TIME_S = np.arange(ROWS) / 5.0
COMMAND = 0.18 * np.sin(np.outer(TIME_S, rng.uniform(0.15, 0.5, 8)) + rng.uniform(0.0, 6.0, 8))
LENGTH_M = held_lengths_m(mechanism_of(LAB), COMMAND)


def sweep(command: np.ndarray = COMMAND, segment: int = 0) -> Recording:
    return Recording(
        name="sweep",
        time_s=TIME_S,
        trial=np.zeros(ROWS, dtype=np.int64),
        command_rad=command,
        load_segment=np.full(ROWS, segment),
        load_n=np.zeros((ROWS, 3)),
        tensions_n=np.full((ROWS, 12), 50.0),
    )


def wave_in(planted: np.ndarray, recording: Recording | None = None):
    noise = rng.normal(0.0, FLOOR_N, (ROWS, 12))
    return periodic(recording or sweep(), noise + planted, FLOOR_N, LAB)


@pytest.mark.parametrize("period_rad", [0.07, 0.15])
def test_notches_of_a_joint(period_rad):
    wave = np.sin(2.0 * np.pi * COMMAND[:, 3] / period_rad)
    found = wave_in(np.outer(wave, rng.normal(size=12)))
    assert found is not None
    assert (found.along, found.unit) == ("joint_2_yaw", "rad")
    assert found.period == pytest.approx(period_rad, rel=0.08)
    assert found.share > 0.5


def test_the_screw_of_a_cable():
    wave = np.sin(2.0 * np.pi * LENGTH_M[:, 6] / 0.004)
    found = wave_in(np.outer(wave, np.eye(12)[6]))
    assert found is not None
    assert (found.along, found.unit) == ("cable_7", "m")
    assert found.period == pytest.approx(0.004, rel=0.08)


def test_screws_of_several_cables_that_are_alike():
    turns = 2.0 * np.pi * LENGTH_M / 0.003
    found = wave_in(np.sin(turns) * np.where(np.isin(np.arange(12), [1, 4, 9]), 1.0, 0.0))
    assert found is not None
    assert found.unit == "m"
    assert found.period == pytest.approx(0.003, rel=0.08)


def test_what_is_smooth_in_the_pose_is_no_wave():
    smooth = 30.0 * COMMAND[:, 0] + 200.0 * COMMAND[:, 1] * COMMAND[:, 4]
    assert wave_in(np.outer(smooth, rng.normal(size=12))) is None


def test_noise_is_no_wave():
    assert wave_in(np.zeros(12)) is None


def test_scatter_is_no_wave():
    assert wave_in(rng.normal(size=(ROWS, 12))) is None


def test_without_motion_or_without_unloaded_rows_there_is_nothing_to_see():
    loud = rng.normal(size=(ROWS, 12))
    assert wave_in(loud, sweep(np.zeros((ROWS, 8)))) is None
    assert wave_in(loud, sweep(segment=2)) is None
