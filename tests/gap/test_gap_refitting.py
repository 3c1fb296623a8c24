"""A fit goes on from numbers that are known, or stays with them."""

from __future__ import annotations

import pytest
from gap_course import FLOOR, Sums, amount, course_of, linear

from cablesense_gap.diagnosis.gauss_newton import refit

GAIN = amount("gain", "a")
COURSE = course_of(Sums(linear("gain", ["a", "b"])), {GAIN: 2.0})


def test_it_ends_at_the_planted_number():
    found = refit(COURSE, {GAIN: 1.0}, 4)
    assert found.values[GAIN] == pytest.approx(2.0, abs=0.02)
    assert found.held_out_rmse < 1.1 * FLOOR


def test_without_a_step_the_numbers_stay():
    assert refit(COURSE, {GAIN: 1.0}, 0).values == {GAIN: 1.0}
