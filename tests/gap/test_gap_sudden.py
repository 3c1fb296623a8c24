"""Steps that last, and jumps while nothing is done."""

from __future__ import annotations

import numpy as np
import pytest
from gap_recordings import small_recording

from cablesense_gap.residual_patterns import jumps, steps

SMALL = small_recording()
FLOOR_N = 0.1
ROWS = len(SMALL)


def noise() -> np.ndarray:
    return np.random.default_rng(6).normal(0.0, FLOOR_N, (ROWS, 12))


def test_noise_has_neither():
    assert steps(SMALL, noise(), FLOOR_N) == ()
    assert jumps(SMALL, noise(), FLOOR_N) == ()


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


def test_jumps_at_rest_are_counted():
    """There and back twice within one load, and once more each for some rows."""
    planted = np.zeros((ROWS, 12))
    planted[[30, 66], 4] = 9.0
    planted[138:140, 4] = -9.0
    (found,) = jumps(SMALL, noise() + planted, FLOOR_N)
    assert (found.channel, found.count) == (4, 5)
    assert found.size_n == pytest.approx(9.0, abs=0.5)


def test_what_comes_with_a_load_or_a_motion_is_no_jump():
    load = np.linalg.norm(SMALL.load_n, axis=1)
    moving = SMALL.trial == SMALL.trial.max()
    wild = np.random.default_rng(1).normal(0.0, 5.0, (ROWS, 12)) * moving[:, None]
    assert jumps(SMALL, noise() + load[:, None] + wild, FLOOR_N) == ()


@pytest.mark.parametrize("keeps", [0.2, 0.5, 0.8])
def test_what_is_late_after_a_load_is_no_jump(keeps):
    load = np.linalg.norm(SMALL.load_n, axis=1)
    late = np.zeros(ROWS)
    for row in range(1, ROWS):
        late[row] = keeps * (late[row - 1] + load[row] - load[row - 1])
    assert jumps(SMALL, noise() - late[:, None], FLOOR_N) == ()
