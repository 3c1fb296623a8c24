"""Held-out trials by sums of products, against fits that are really made without them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_gap.diagnosis.linear_fit import Reduced, held_out_squares, products

ROWS = 60
CHANNELS = 2
TRIALS = 6


def drawn(seed: int, columns: int = 4):
    """Columns, a residual that they explain in part, trials of uneven length, rows that count."""
    rng = np.random.default_rng(seed)
    trial = np.sort(np.append(np.arange(TRIALS), rng.integers(0, TRIALS, ROWS - TRIALS)))
    x = rng.normal(size=(columns, ROWS, CHANNELS))
    y = np.tensordot(rng.normal(size=columns), x, axes=1) + rng.normal(size=(ROWS, CHANNELS))
    used = (rng.random(ROWS) < 0.9) | (np.arange(ROWS) < 3)
    return x, y, trial, used


def directly(x, y, precision, offset, weight_):
    """The ridge of the same priors as one least-squares problem with more rows."""
    flat = x.reshape(len(x), -1).T
    a = np.vstack([np.sqrt(weight_) * flat, np.diag(np.sqrt(precision))])
    b = np.concatenate([np.sqrt(weight_) * y.ravel(), -np.sqrt(precision) * offset])
    return np.linalg.lstsq(a, b, rcond=None)[0]


@given(st.integers(0, 10_000), st.floats(0.01, 100.0), st.integers(2, 4), st.integers(1, 2))
@settings(max_examples=15, deadline=None)
def test_held_out_squares_are_those_of_fits_without_the_fold(seed, weight_, folds, tolerances):
    x, y, trial, used = drawn(seed)
    rng = np.random.default_rng(seed + 1)
    precision = rng.uniform(0.1, 3.0, 4)
    offset = rng.normal(size=4)
    fold = np.arange(TRIALS) % folds
    t = slice(tolerances)
    data = products(x, y, trial, used).of_folds(fold)
    squares_of_folds = held_out_squares(data, tolerances, precision, offset, weight_)
    for k in range(folds):
        others = used & (fold[trial] != k)
        here = used & (fold[trial] == k)
        fitted = directly(x[:, others], y[others], precision, offset, weight_)
        beside = y - np.tensordot(fitted[tolerances:], x[tolerances:], axes=1)
        fitted[t] = directly(x[t, used], beside[used], precision[t], offset[t], weight_)
        residual = y[here] - np.tensordot(fitted, x[:, here], axes=1)
        assert squares_of_folds[k] == pytest.approx((residual**2).sum(), rel=1e-6, abs=1e-9)
    columns = [*range(tolerances), 3]
    no_prior = np.zeros(4)
    reduced = Reduced(data, tolerances, tolerances, precision, weight_)
    squares = held_out_squares(
        data.columns(columns), tolerances, precision[columns], no_prior[columns], weight_
    )
    mean_square = reduced.left(np.array([[3 - tolerances]]))[0][0]
    assert mean_square == pytest.approx(squares.sum() / data.count.sum(), rel=1e-6, abs=1e-9)
