"""Held-out trials by sums of products, against fits that are really made without them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_gap.diagnosis.linear_fit import (
    Reduced,
    fold_solutions,
    held_out_squares,
    products,
    solve,
    weight,
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


def test_the_solution_of_a_fold_has_not_seen_it():
    x, y, trial, used = drawn(3)
    fold = np.array([0, 0, 1, 1, 2, 2])
    plain = np.ones(4), np.zeros(4), 2.0, fold
    before = fold_solutions(products(x, y, trial, used), *plain)
    y[fold[trial] == 1] += 100.0
    after = fold_solutions(products(x, y, trial, used), *plain)
    np.testing.assert_allclose(after[1], before[1], rtol=1e-9)
    assert np.abs(after[[0, 2]] - before[[0, 2]]).min() > 0.1


def test_products_add_up_over_trials_and_are_chosen_by_column():
    x, y, trial, used = drawn(0)
    parts = products(x, y, trial, used)
    whole = products(x, y, np.zeros_like(trial), used)
    some, expected = parts.columns([3, 1]), products(x[[3, 1]], y, trial, used)
    for name in ("gram", "moment", "square", "count"):
        np.testing.assert_allclose(getattr(parts, name).sum(0), getattr(whole, name)[0])
        np.testing.assert_allclose(getattr(some, name), getattr(expected, name))
    assert parts.count.sum() == CHANNELS * used.sum()
    assert parts.mean_square == pytest.approx((y[used] ** 2).mean())


def test_rows_that_do_not_count_do_not_count():
    x, y, trial, used = drawn(1)
    used &= trial != 4
    before = products(x, y, trial, used)
    x[:, ~used], y[~used] = np.nan, np.nan
    after = products(x, y, trial, used)
    np.testing.assert_array_equal(after.gram, before.gram)
    np.testing.assert_array_equal(after.square, before.square)
    assert after.count[4] == 0.0
    squares = held_out_squares(after, np.ones(4), np.zeros(4), 1.0, np.arange(TRIALS) % 3)
    assert squares[4] == 0.0


def test_without_columns_all_is_left():
    x, y, trial, used = drawn(5)
    data = products(x[:0], y, trial, used)
    squares = held_out_squares(data, np.ones(0), np.zeros(0), 1.0, np.arange(TRIALS) % 3)
    np.testing.assert_allclose(squares, data.square)


def test_without_data_the_prior_holds():
    found = solve(np.zeros((2, 2)), np.zeros(2), np.array([1.0, 4.0]), np.array([0.5, -2.0]), 3.0)
    np.testing.assert_allclose(found, [-0.5, 2.0])


def test_the_larger_the_residual_the_less_each_number_counts():
    """At the floor it has the weight of white noise; beyond, less than its size implies."""
    weights = [weight(mean_square, 0.2) for mean_square in (0.01, 0.04, 0.05, 1.0, 100.0)]
    assert weights[0] == weights[1] == pytest.approx(25.0)
    assert weights[1:] == sorted(weights[1:], reverse=True)
    assert weight(4.0, 1.0) < 1.0 / 4.0


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
    found = reduced.mean_squares(np.array(sets)), reduced.base_chi2(np.array(sets), base)
    for chosen, *each in zip(sets, *found, strict=True):
        at = np.concatenate([np.arange(base), base + np.array(chosen, dtype=int)])
        part, none = data.columns(at), np.zeros(len(at))
        squares = held_out_squares(part, precision[at], none, weight_, fold)
        fitted = solve(part.gram.sum(0), part.moment.sum(0), precision[at], none, weight_)
        expected = squares.sum() / part.count.sum(), (fitted[:base] ** 2).sum()
        np.testing.assert_allclose(each, expected, rtol=1e-6, atol=1e-9)


def test_a_perfect_fit_leaves_no_less_than_nothing():
    x, _, trial, _ = drawn(4, 5)
    residual = np.tensordot([1.0, -2.0, 3.0], x[:3], axes=1)
    data = products(x, residual, trial, np.ones(ROWS, dtype=bool))
    reduced = Reduced(data, 2, np.full(5, 1e-6), 1e9, np.arange(TRIALS) % 3)
    (left,) = reduced.mean_squares(np.array([[0]]))
    assert 0.0 <= left < 1e-10
