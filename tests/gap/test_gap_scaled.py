"""Parameters in units of what is typical."""

from __future__ import annotations

import numpy as np
import pytest
from gap_course import rate, size
from hypothesis import given
from hypothesis import strategies as st

from cablesense_gap.diagnosis.problem import (
    from_scaled,
    is_logarithmic,
    prior_precision,
    to_scaled,
)
from cablesense_sim.effects.effect import Parameter

SIZE, RATE = size("amount", typical=4.0, most=100.0), rate()
SHIFT = Parameter("shift", "1", -2.0, 2.0, 0.5, "a shape that may be zero", 0.0, "shape")


@given(st.sampled_from([SIZE, RATE, SHIFT]), st.floats(0.0, 1.0))
def test_there_and_back_is_the_same(parameter, share):
    value = parameter.low + share * (parameter.high - parameter.low)
    assert from_scaled(parameter, to_scaled(parameter, value)) == pytest.approx(value, abs=1e-12)


@given(st.sampled_from([SIZE, RATE, SHIFT]), st.floats(-50.0, 50.0))
def test_no_scaled_number_leaves_the_plausible_range(parameter, scaled):
    assert parameter.low <= from_scaled(parameter, scaled) <= parameter.high


def test_one_is_the_typical_size():
    assert to_scaled(SIZE, 4.0) == 1.0
    assert from_scaled(SIZE, -1.0) == -4.0


def test_only_what_is_never_zero_is_sought_by_its_logarithm():
    assert is_logarithmic(RATE)
    assert not is_logarithmic(SHIFT)
    assert not is_logarithmic(SIZE)
    assert to_scaled(RATE, np.e) == pytest.approx(1.0)


def test_a_size_is_expected_to_be_of_some_typical_ones():
    deviation = prior_precision(SIZE) ** -0.5
    assert 1.0 <= deviation <= 10.0
    assert prior_precision(RATE) > 0.0
