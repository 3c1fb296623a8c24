"""Kernel ridge regression on folds that it has not seen."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from cablesense_gap.diagnosis.discrepancy import held_out, kernel

rng = np.random.default_rng(3)
ROWS = 150
X = rng.uniform(-2.0, 2.0, (ROWS, 2))
FOLD = np.arange(ROWS) // 10 % 5
ALL = np.ones(ROWS, dtype=bool)


def left(y: np.ndarray, *groups: np.ndarray, used: np.ndarray = ALL) -> np.ndarray:
    predicted = held_out(kernel(groups or [X]), y, FOLD, used)
    return ((y - predicted) ** 2).mean(0) / (y**2).mean(0)


def test_a_kernel_is_symmetric_and_has_no_negative_direction():
    found = kernel([X, X[:, :1] ** 2])
    assert_allclose(found, found.T)
    assert np.linalg.eigvalsh(found).min() > -1e-9 * np.linalg.eigvalsh(found).max()


def test_straight_and_bent_functions_are_predicted_and_noise_is_not():
    y = np.column_stack([X @ [1.0, -2.0], np.sin(2.0 * X[:, 0]), rng.normal(size=ROWS)])
    share = left(y)
    assert share[0] < 1e-3
    assert share[1] < 0.05
    assert 0.95 < share[2] < 1.1


def test_what_two_groups_make_together_is_predicted_by_both_alone_by_neither():
    y = (X[:, 0] * X[:, 1])[:, None]
    assert left(y, X[:, :1], X[:, 1:])[0] < 0.1
    assert left(y, X[:, :1])[0] > 0.8


def test_a_fold_is_predicted_without_its_own_rows():
    y = np.sin(2.0 * X[:, :1])
    other = y.copy()
    other[FOLD == 2] += 7.0
    before, after = (held_out(kernel([X]), each, FOLD, ALL) for each in (y, other))
    assert_array_equal(before[FOLD == 2], after[FOLD == 2])


def test_rows_that_do_not_count_are_not_learnt_from():
    used = rng.random(ROWS) < 0.8
    y = np.sin(2.0 * X[:, :1])
    other = np.where(used[:, None], y, 99.0)
    first, second = (held_out(kernel([X]), each, FOLD, used) for each in (y, other))
    assert_array_equal(first, second)
