"""Held-out trials by sums of products, against fits that are really made without them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_gap.diagnosis.linear_fit import held_out_squares, products

ROWS, CHANNELS, TRIALS = 60, 2, 6


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


@given(st.integers(0, 10_000), st.floats(0.01, 100.0), st.integers(2, 4))
@settings(max_examples=15, deadline=None)
def test_held_out_squares_are_those_of_fits_without_the_fold(seed, weight_, folds):
    x, y, trial, used = drawn(seed)
    rng = np.random.default_rng(seed + 1)
    precision, offset = rng.uniform(0.1, 3.0, 4), rng.normal(size=4)
    fold = np.arange(TRIALS) % folds
    found = held_out_squares(products(x, y, trial, used), precision, offset, weight_, fold)
    for t in range(TRIALS):
        others = used & (fold[trial] != fold[t])
        here = used & (trial == t)
        fitted = directly(x[:, others], y[others], precision, offset, weight_)
        left = y[here] - np.tensordot(fitted, x[:, here], axes=1)
        assert found[t] == pytest.approx((left**2).sum(), rel=1e-6, abs=1e-9)
