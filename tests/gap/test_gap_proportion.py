"""Proportions and their intervals, against SciPy and against draws."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest

from cablesense_gap.scoring import Proportion


@given(count=st.integers(1, 500), data=st.data())
def test_the_interval_is_wilsons(count, data):
    hits = data.draw(st.integers(0, count))
    found = Proportion(hits, count)
    expected = binomtest(hits, count).proportion_ci(method="wilson")
    assert found.ci95 == pytest.approx((expected.low, expected.high), abs=1e-12)
    assert found.ci95[0] <= found.value <= found.ci95[1]


@pytest.mark.parametrize("truth", [0.05, 0.5, 0.9])
def test_the_interval_holds_the_truth_about_as_often_as_it_says(truth):
    drawn = np.random.default_rng(5).binomial(40, truth, 2000)
    held = np.mean([low <= truth <= high for low, high in (Proportion(k, 40).ci95 for k in drawn)])
    assert held == pytest.approx(0.95, abs=0.03)


def test_outcomes_are_counted():
    assert Proportion.of(k > 2 for k in range(5)) == Proportion(2, 5)


def test_no_case_says_nothing():
    nothing = Proportion.of([])
    assert nothing.value is None
    assert nothing.ci95 == (0.0, 1.0)
