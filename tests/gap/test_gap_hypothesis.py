"""What an explanation leaves, and how that is measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap_course import explanation
from hypothesis import given
from hypothesis import strategies as st

from cablesense_gap.diagnosis.problem import excess
from cablesense_gap.simulator import Term

PLACES = "b", "a", "b"
ONE = replace(
    explanation("gain"),
    values={Term("gain", place, f"x{k}"): 1.0 for k, place in enumerate(PLACES)},
    squares=np.array([4.0, 14.0]),
    count=np.array([4.0, 4.0]),
)


def test_the_held_out_error_is_over_all_numbers_of_all_trials():
    assert ONE.held_out_rmse == pytest.approx(1.5)
    longer = replace(ONE, count=np.array([2.0, 6.0]))
    assert longer.held_out_rmse == pytest.approx(1.5)


def test_places_are_named_once_in_their_order():
    assert ONE.places == ("b", "a")


@given(st.floats(0.0, 100.0), st.floats(0.0, 100.0), st.floats(0.01, 10.0))
def test_more_left_is_more_excess(one, other, floor):
    less, more = sorted((one, other))
    assert 0.0 < excess(less, floor) <= excess(more, floor)


def test_nothing_is_told_apart_below_the_floor():
    assert excess(0.0, 0.3) == excess(0.09, 0.3) < 0.3


def test_far_above_the_floor_the_excess_is_what_is_left():
    assert excess(100.0, 0.1) == pytest.approx(10.0, rel=1e-3)
