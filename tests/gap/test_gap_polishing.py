"""A last fit beside tolerances as they act on the amended mechanism."""

from __future__ import annotations

import numpy as np
import pytest
from gap_course import FLOOR, SIGNALS, Sums, amount, course_of, linear, scatter

from cablesense_gap.diagnosis.fitting import polish
from cablesense_gap.diagnosis.gauss_newton import refine

GAIN, OFF = amount("gain", "a"), amount("scatter", "b")


class Coupled(Sums):
    """What a tolerance changes grows with the effect, as it does where an effect is large."""

    def _one(self, variant):
        gain, off = variant.get(GAIN, 0.0), variant.get(OFF, 0.0)
        return super()._one(variant) + 40.0 * gain * off * SIGNALS[3]


def fitted(course):
    parameter = course.simulator.candidates[0].parameters[0]
    found = refine(course, {GAIN: parameter}, [[2.0]])
    assert found is not None
    return found


def coupled():
    return course_of(Coupled(linear("gain", ["a"]), scatter()), {GAIN: 2.0, OFF: 0.05})


def test_tolerances_are_taken_as_they_act_beside_the_effect():
    course = coupled()
    rough = fitted(course)
    smooth = polish(course, rough)
    assert rough.held_out_rmse > 10.0 * FLOOR
    assert smooth.held_out_rmse < 1.1 * FLOOR
    assert smooth.values[GAIN] == pytest.approx(2.0, abs=0.02)
    assert smooth.tolerances[OFF] == pytest.approx(0.05, rel=0.5)


def test_a_fit_that_is_as_good_as_can_be_stays():
    course = course_of(Sums(linear("gain", ["a"])), {GAIN: 1.0})
    before = fitted(course)
    after = polish(course, before)
    assert after.values[GAIN] == pytest.approx(before.values[GAIN], abs=1e-3)
    assert course.cost_of(after) <= course.cost_of(before)


def test_tolerances_alone_need_no_polish():
    course = coupled()
    none = refine(course, {}, [[]])
    assert polish(course, none) is none


def test_a_mechanism_that_cannot_be_simulated_there_keeps_its_old_fit():
    class Fragile(Coupled):
        def _one(self, variant):
            broken = GAIN in variant and OFF in variant
            return np.nan * SIGNALS[0] if broken else super()._one(variant)

    course = course_of(Fragile(linear("gain", ["a"]), scatter()), SIGNALS[0])
    before = fitted(course)
    assert course.cost_of(polish(course, before)) <= course.cost_of(before)
