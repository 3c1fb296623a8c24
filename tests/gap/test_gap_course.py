"""A recording beside its simulator."""

from __future__ import annotations

import numpy as np
from gap_course import SIGNALS, TIME, TRIAL, Sums, linear, scatter
from numpy.testing import assert_allclose, assert_array_equal

from cablesense_gap.diagnosis.problem import prepare
from cablesense_gap.simulator import Term

READINGS = SIGNALS[0]
FOLD, USED = np.arange(12) % 4, np.ones(len(TRIAL), dtype=bool)


def test_tolerances_are_columns_of_one_standard_deviation():
    course = prepare(Sums({}, scatter(0.2)), READINGS, TRIAL, FOLD, USED)
    assert course.tolerance_terms == (
        Term("scatter", "a", "amount"), Term("scatter", "b", "amount"),
    )  # fmt: skip
    assert_allclose(course.tolerance_std, 0.2)
    assert_allclose(course.tolerance_columns[0], 0.2)
    assert_allclose(course.tolerance_columns[1], 0.2 * np.outer(TIME, [1.0, 0.0, -1.0]))


def test_without_tolerances_there_are_no_columns():
    course = prepare(Sums(linear("a", ["x"]), {}), READINGS, TRIAL, FOLD, USED)
    assert course.tolerance_columns.shape == (0, *READINGS.shape)
    assert_array_equal(course.nominal, 0.0)


def test_trials_are_counted_from_zero_whatever_their_numbers():
    course = prepare(Sums({}), READINGS, 5 * TRIAL + 7, FOLD, USED)
    assert_array_equal(course.trial, TRIAL)


def test_the_floor_is_that_of_the_sensors():
    assert prepare(Sums({}, floor=0.3), READINGS, TRIAL, FOLD, USED).floor == 0.3
