"""Held-out trials by sums of products, against fits that are really made without them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_gap.diagnosis.linear_fit import (
    Products,
    Reduced,
    fold_solutions,
    held_out_squares,
    products,
    solve,
    weight,
)

ROWS, CHANNELS = 60, 2


def drawn(seed: int, columns: int = 4, trials: int = 6):
    """Columns, a residual that they explain in part, trials of uneven length, rows that count."""
    rng = np.random.default_rng(seed)
    trial = np.sort(np.append(np.arange(trials), rng.integers(0, trials, ROWS - trials)))
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
@settings(max_examples=40, deadline=None)
def test_held_out_squares_are_those_of_fits_without_the_fold(seed, weight_, folds):
    x, y, trial, used = drawn(seed)
    rng = np.random.default_rng(seed + 1)
    precision, offset = rng.uniform(0.1, 3.0, 4), rng.normal(size=4)
    fold = np.arange(6) % folds
    found = held_out_squares(products(x, y, trial, used), precision, offset, weight_, fold)
    for t in range(6):
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


def test_products_of_trials_add_up_to_those_of_all():
    x, y, trial, used = drawn(0)
    parts = products(x, y, trial, used)
    whole = products(x, y, np.zeros_like(trial), used)
    for name in ("gram", "moment", "square", "count"):
        np.testing.assert_allclose(getattr(parts, name).sum(0), getattr(whole, name)[0])
    assert parts.count.sum() == CHANNELS * used.sum()
    assert parts.mean_square == pytest.approx((y[used] ** 2).mean())


def test_rows_that_do_not_count_do_not_count():
    x, y, trial, used = drawn(1)
    before = products(x, y, trial, used)
    x[:, ~used], y[~used] = np.nan, np.nan
    after = products(x, y, trial, used)
    np.testing.assert_array_equal(after.gram, before.gram)
    np.testing.assert_array_equal(after.square, before.square)


def test_a_trial_without_rows_that_count_is_left_with_nothing():
    x, y, trial, used = drawn(2)
    data = products(x, y, trial, used & (trial != 4))
    assert data.count[4] == 0.0
    squares = held_out_squares(data, np.ones(4), np.zeros(4), 1.0, np.arange(6) % 3)
    assert squares[4] == 0.0


def test_some_columns_have_the_products_of_these_columns():
    x, y, trial, used = drawn(4)
    chosen = [3, 1]
    some = products(x, y, trial, used).columns(chosen)
    expected = products(x[chosen], y, trial, used)
    np.testing.assert_allclose(some.gram, expected.gram)
    np.testing.assert_allclose(some.moment, expected.moment)


def test_without_columns_all_is_left():
    x, y, trial, used = drawn(5)
    data = products(x[:0], y, trial, used)
    assert isinstance(data, Products)
    squares = held_out_squares(data, np.ones(0), np.zeros(0), 1.0, np.arange(6) % 3)
    np.testing.assert_allclose(squares, data.square)


def test_the_solution_is_most_probable():
    """Its posterior falls to all sides."""
    x, y, trial, used = drawn(6)
    data = products(x, y, trial, used)
    precision, offset = np.array([0.5, 1.0, 2.0, 9.0]), np.array([1.0, 0.0, -2.0, 0.3])

    def cost(c):
        left = (y - np.tensordot(c, x, axes=1))[used]
        return 0.7 * (left**2).sum() + (precision * (c + offset) ** 2).sum()

    found = solve(data.gram.sum(0), data.moment.sum(0), precision, offset, 0.7)
    for step in 1e-3 * np.vstack([np.eye(4), -np.eye(4)]):
        assert cost(found + step) > cost(found)


def test_without_data_the_prior_holds():
    found = solve(np.zeros((2, 2)), np.zeros(2), np.array([1.0, 4.0]), np.array([0.5, -2.0]), 3.0)
    np.testing.assert_allclose(found, [-0.5, 2.0])


@given(st.floats(0.01, 10.0), st.floats(0.0, 1e3), st.floats(0.0, 1e3))
def test_the_more_is_left_unexplained_the_less_each_number_counts(floor, one, other):
    less, more = sorted((one, other))
    assert weight(more, floor) <= weight(less, floor) <= 1.0 / floor**2


def test_noise_alone_has_the_weight_of_white_noise():
    assert weight(0.04, 0.2) == pytest.approx(25.0)
    assert weight(0.01, 0.2) == pytest.approx(25.0)


def test_what_hangs_together_counts_less_than_its_size_says():
    """A residual of twice the floor is no white noise of twice the floor."""
    assert weight(4.0, 1.0) < 1.0 / 4.0


ROWS_REDUCED, TRIALS, COLUMNS = 80, 8, 9
TRIAL = np.sort(np.append(np.arange(TRIALS), np.arange(ROWS_REDUCED - TRIALS) % TRIALS))


def drawn_reduced(seed, base):
    """Products of columns and of a residual that they explain in part, with their priors."""
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(base + COLUMNS, ROWS_REDUCED, 2))
    residual = np.tensordot(rng.normal(size=len(columns)), columns, axes=1)
    residual += rng.normal(size=residual.shape)
    used = (rng.random(ROWS_REDUCED) < 0.9) | (np.arange(ROWS_REDUCED) < 3)
    return products(columns, residual, TRIAL, used), rng.uniform(0.1, 3.0, len(columns))


def directly_reduced(data, precision, base, chosen, weight_, fold):
    """The mean square that is left, and the strain of the base, of one fit of all columns."""
    at = np.concatenate([np.arange(base), base + np.array(chosen, dtype=int)])
    part, none = data.columns(at), np.zeros(len(at))
    squares = held_out_squares(part, precision[at], none, weight_, fold)
    found = solve(part.gram.sum(0), part.moment.sum(0), precision[at], none, weight_)
    return squares.sum() / part.count.sum(), (found[:base] ** 2).sum()


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
@settings(max_examples=60, deadline=None)
def test_each_set_of_columns_leaves_what_a_fit_of_all_leaves(seed, base, sets, weight_, folds):
    data, precision = drawn_reduced(seed, base)
    fold = np.arange(TRIALS) % folds
    reduced = Reduced(data, base, precision, weight_, fold)
    left, tolerance_chi2 = (
        reduced.mean_squares(np.array(sets)),
        reduced.base_chi2(np.array(sets), base),
    )
    expected = [directly_reduced(data, precision, base, s, weight_, fold) for s in sets]
    np.testing.assert_allclose(
        np.column_stack([left, tolerance_chi2]), expected, rtol=1e-6, atol=1e-9
    )


def test_the_order_within_a_set_does_not_matter():
    data, precision = drawn_reduced(0, 3)
    reduced = Reduced(data, 3, precision, 1.0, np.arange(TRIALS) % 4)
    one, other = reduced.mean_squares(np.array([[1, 5, 2], [2, 1, 5]]))
    assert one == pytest.approx(other, rel=1e-9)


def test_nothing_left_is_not_less_than_nothing():
    """Without noise rounding is all there is."""
    rng = np.random.default_rng(4)
    columns = rng.normal(size=(5, ROWS_REDUCED, 2))
    residual = np.tensordot([1.0, -2.0, 3.0], columns[:3], axes=1)
    data = products(columns, residual, TRIAL, np.ones(ROWS_REDUCED, dtype=bool))
    reduced = Reduced(data, 2, np.full(5, 1e-6), 1e9, np.arange(TRIALS) % 4)
    (left,) = reduced.mean_squares(np.array([[0]]))
    assert 0.0 <= left < 1e-10
