"""Held-out trials by sums of products, against fits that are really made without them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_gap.diagnosis.linear_fit import (
    Reduced,
    held_out_squares,
    products,
    solve,
)

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


COLUMNS = 9


@given(
    st.integers(0, 10_000),
    st.integers(0, 4),
    st.integers(1, 4).flatmap(
        lambda k: st.lists(
            st.lists(st.integers(0, COLUMNS - 1), min_size=k, max_size=k, unique=True),
            min_size=1,
            max_size=5,
        )
    ),
    st.floats(0.01, 100.0),
    st.integers(2, 5),
)
@settings(max_examples=20, deadline=None)
def test_each_set_of_columns_leaves_what_a_fit_of_all_leaves(seed, base, sets, weight_, folds):
    x, y, trial, used = drawn(seed, base + COLUMNS)
    data = products(x, y, trial, used)
    precision = np.random.default_rng(seed).uniform(0.1, 3.0, len(x))
    fold = np.arange(TRIALS) % folds
    reduced = Reduced(data, base, precision, weight_, fold)
    found = reduced.left(np.array(sets), base)
    for chosen, *each in zip(sets, *found, strict=True):
        at = np.concatenate([np.arange(base), base + np.array(chosen, dtype=int)])
        part, none = data.columns(at), np.zeros(len(at))
        squares = held_out_squares(part, precision[at], none, weight_, fold)
        fitted = solve(part.gram.sum(0), part.moment.sum(0), precision[at], none, weight_)
        expected = squares.sum() / part.count.sum(), (fitted[:base] ** 2).sum()
        np.testing.assert_allclose(each, expected, rtol=1e-6, atol=1e-9)
