"""Steps that last and single rows that are far off."""

from __future__ import annotations

import numpy as np
import pytest
from gap_recordings import small_recording

from cablesense_gap.residuals.sudden import spikes, steps

SMALL = small_recording()
FLOOR_N = 0.1
ROWS = len(SMALL)


def noise() -> np.ndarray:
    return np.random.default_rng(6).normal(0.0, FLOOR_N, (ROWS, 12))


def test_noise_has_neither():
    assert steps(SMALL, noise(), FLOOR_N) == ()
    assert spikes(SMALL, noise(), FLOOR_N) == ()


def test_a_step_is_told_with_its_time_size_and_cable():
    planted = np.outer(np.arange(ROWS) >= 150, -1.3 * np.eye(12)[7])
    (found,) = steps(SMALL, noise() + planted, FLOOR_N)
    assert found.channel == 7
    assert found.time_s == pytest.approx(SMALL.time_s[150], abs=0.5)
    assert found.size_n == pytest.approx(-1.3, abs=0.1)


def test_a_load_that_comes_and_goes_is_no_step():
    load = np.linalg.norm(SMALL.load_n, axis=1)
    assert steps(SMALL, noise() + 0.1 * load[:, None], FLOOR_N) == ()


def test_a_step_at_the_very_end_is_not_told_from_chance():
    planted = np.outer(np.arange(ROWS) >= ROWS - 5, 2.0 * np.eye(12)[7])
    assert steps(SMALL, noise() + planted, FLOOR_N) == ()


def test_rows_that_are_far_off_are_counted():
    planted = np.zeros((ROWS, 12))
    planted[[29, 65, 101, 330], 4] = [9.0, -9.0, 9.0, 9.0]
    (found,) = spikes(SMALL, noise() + planted, FLOOR_N)
    assert (found.channel, found.count) == (4, 4)
    assert found.size_n == pytest.approx(9.0, abs=0.5)


def test_what_is_late_after_a_load_is_no_spike():
    changed = np.abs(np.diff(SMALL.load_n, axis=0, prepend=SMALL.load_n[:1])).max(1) > 0.0
    assert spikes(SMALL, noise() + 5.0 * changed[:, None], FLOOR_N) == ()
