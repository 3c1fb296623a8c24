"""Sizes of the gap before and after, and intervals that whole trials give them."""

from __future__ import annotations

import numpy as np
import pytest

from cablesense_gap.diagnose import gap_size, rmse_interval_n

CABLES, ROWS, TRIALS = 3, 40, 20
TRIAL = np.repeat(np.arange(TRIALS), ROWS)
RNG = np.random.default_rng(3)
WHITE = RNG.normal(size=(len(TRIAL), CABLES))


def test_sizes_are_root_mean_squares():
    by_cable = np.array([0.5, 1.0, 2.0])
    before_n, after_n = np.tile(by_cable, (len(TRIAL), 1)), np.full((len(TRIAL), CABLES), 0.1)
    found = gap_size(before_n, after_n, TRIAL, floor_n=0.1)
    assert found.before_n == pytest.approx(np.sqrt((by_cable**2).mean()))
    assert found.by_cable_n == pytest.approx(tuple(by_cable))
    assert (found.after_n, found.floor_n) == (pytest.approx(0.1), 0.1)
    assert found.removed_fraction == pytest.approx(1.0)
    assert found.ci95 == pytest.approx((1.0, 1.0))


def test_half_of_what_can_be_removed_is_a_half():
    ones = np.ones((len(TRIAL), CABLES))
    assert gap_size(1.1 * ones, 0.6 * ones, TRIAL, 0.1).removed_fraction == pytest.approx(0.5)


def test_a_gap_that_grew_is_below_zero_and_nothing_to_remove_is_none():
    ones = np.ones((len(TRIAL), CABLES))
    assert gap_size(1.0 * ones, 1.5 * ones, TRIAL, 0.1).removed_fraction < 0.0
    assert gap_size(0.05 * ones, 0.02 * ones, TRIAL, 0.1).removed_fraction == 0.0


def test_trials_that_differ_widen_the_interval():
    """As many rows, as large a gap; what counts is how far trials agree."""
    alike = 1.0 + 0.1 * WHITE
    by_trial = np.repeat(RNG.uniform(0.2, 1.8, TRIALS), ROWS)[:, None] * alike
    narrow, wide = (gap_size(2.0 * alike, r, TRIAL, 0.01).ci95 for r in (alike, by_trial))
    assert wide[1] - wide[0] > 5.0 * (narrow[1] - narrow[0])


def test_the_same_residuals_give_the_same_interval():
    one, other = (gap_size(2.0 * WHITE, WHITE, TRIAL, 0.1) for _ in range(2))
    assert one == other


def test_trials_whose_rows_do_not_count_say_nothing():
    """Where only two of three trials are left, a draw must not meet the empty one alone."""
    few = np.isin(TRIAL, [1, 4])
    found = gap_size(2.0 * WHITE[few], WHITE[few], TRIAL[few], 0.1)
    assert np.isfinite(found.ci95).all()
    squares, count = np.array([0.0, 8.0, 18.0]), np.array([0.0, 2.0, 2.0])
    assert rmse_interval_n(squares, count) == pytest.approx((2.0, 3.0))


def test_the_interval_of_a_size_holds_it_as_often_as_it_says():
    held = 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        squares = (rng.normal(size=(30, 50)) ** 2).sum(1)
        low, high = rmse_interval_n(squares, np.full(30, 50.0))
        held += low <= 1.0 <= high
    assert 0.85 < held / 200 < 0.99
