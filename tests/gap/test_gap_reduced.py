"""Eliminating the base once gives what fits of all columns together give."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_gap.diagnosis.evidence import Reduced, held_out_squares, products, solve

ROWS, TRIALS, COLUMNS = 80, 8, 9
TRIAL = np.sort(np.append(np.arange(TRIALS), np.arange(ROWS - TRIALS) % TRIALS))


def drawn(seed, base):
    """Products of columns and of a residual that they explain in part, with their priors."""
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(base + COLUMNS, ROWS, 2))
    residual = np.tensordot(rng.normal(size=len(columns)), columns, axes=1)
    residual += rng.normal(size=residual.shape)
    used = (rng.random(ROWS) < 0.9) | (np.arange(ROWS) < 3)
    return products(columns, residual, TRIAL, used), rng.uniform(0.1, 3.0, len(columns))


def directly(data, precision, base, chosen, weight_, fold):
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
    data, precision = drawn(seed, base)
    fold = np.arange(TRIALS) % folds
    reduced = Reduced(data, base, precision, weight_, fold)
    left, strains = reduced.mean_squares(np.array(sets)), reduced.strains(np.array(sets))
    expected = [directly(data, precision, base, s, weight_, fold) for s in sets]
    np.testing.assert_allclose(np.column_stack([left, strains]), expected, rtol=1e-6, atol=1e-9)


def test_the_order_within_a_set_does_not_matter():
    data, precision = drawn(0, 3)
    reduced = Reduced(data, 3, precision, 1.0, np.arange(TRIALS) % 4)
    one, other = reduced.mean_squares(np.array([[1, 5, 2], [2, 1, 5]]))
    assert one == pytest.approx(other, rel=1e-9)


def test_nothing_left_is_not_less_than_nothing():
    """Without noise rounding is all there is."""
    rng = np.random.default_rng(4)
    columns = rng.normal(size=(5, ROWS, 2))
    residual = np.tensordot([1.0, -2.0, 3.0], columns[:3], axes=1)
    data = products(columns, residual, TRIAL, np.ones(ROWS, dtype=bool))
    reduced = Reduced(data, 2, np.full(5, 1e-6), 1e9, np.arange(TRIALS) % 4)
    (left,) = reduced.mean_squares(np.array([[0]]))
    assert 0.0 <= left < 1e-10
