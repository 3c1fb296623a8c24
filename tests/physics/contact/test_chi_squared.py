"""Tails of chi-squared agree with SciPy's, which the robot's install does without."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2

from cablesense_contact.chi_squared import limit_at, probability_above


@given(value=st.floats(0.0, 5e3), freedom=st.integers(1, 1200))
def test_the_probability_above_is_that_of_scipy(value: float, freedom: int) -> None:
    expected = chi2.sf(value, freedom)
    np.testing.assert_allclose(probability_above(value, freedom), expected, 1e-8, 1e-290)


@given(exponent=st.floats(-12.0, -0.01), freedom=st.integers(1, 600))
def test_a_limit_is_that_of_scipy(exponent: float, freedom: int) -> None:
    probability = 10.0**exponent
    expected = chi2.isf(probability, freedom)
    np.testing.assert_allclose(limit_at(probability, freedom), expected, 1e-9)


@pytest.mark.parametrize("freedom", [1, 2, 12, 301])
def test_the_ends_are_certain(freedom: int) -> None:
    assert probability_above(0.0, freedom) == 1.0
    assert probability_above(-3.0, freedom) == 1.0
    assert probability_above(math.inf, freedom) == 0.0
    assert math.isnan(probability_above(math.nan, freedom))


@pytest.mark.parametrize("freedom", [0, -1])
def test_without_freedom_nothing_can_be_judged(freedom: int) -> None:
    assert math.isnan(probability_above(1.0, freedom))
    assert math.isnan(limit_at(0.01, freedom))
