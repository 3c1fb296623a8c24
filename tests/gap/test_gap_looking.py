"""First looks: which come first, and what they see beside what is there already."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap_course import (
    FLOOR,
    SIGNALS,
    Sums,
    amount,
    course_of,
    explanation,
    fading,
    linear,
    rate,
    scatter,
    size,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_gap.diagnosis.gauss_newton import refine
from cablesense_gap.diagnosis.places import Placed, blocks
from cablesense_gap.diagnosis.problem import excess
from cablesense_gap.diagnosis.screening import (
    Look,
    by_forecast,
    joint_looks,
    promising,
    single_looks,
)
from cablesense_gap.simulator import Term

LIBRARY = {**linear("zero", "ab", SIGNALS[3:]), **linear("gain", "abc")}
GAIN, ZERO = amount("gain", "b"), amount("zero", "a")
QUIET = course_of(Sums(LIBRARY), {})


def offer(course):
    return {c.effect: (c, blocks(course, c)) for c in course.simulator.candidates}


def leaving(rmse, strain=0.0):
    """A look at nothing in particular that leaves so much."""
    return Look(Placed((), np.empty(0), np.empty(0), rmse**2, strain))


def gain_alone(course):
    found = refine(course, {GAIN: size("amount")}, [[1.0]])
    assert found is not None
    return found


@given(st.lists(st.floats(0.2, 10.0), min_size=2, max_size=6))
@settings(deadline=None)
def test_what_leaves_least_comes_first(left):
    ordered = by_forecast(QUIET, [leaving(rmse) for rmse in left])
    assert [look.placed.mean_square for look in ordered] == sorted(rmse**2 for rmse in left)


def test_what_strains_tolerances_comes_later():
    strained, easy = leaving(1.0, strain=100.0), leaving(1.0, strain=1.0)
    assert by_forecast(QUIET, [strained, easy]) == [easy, strained]
    assert by_forecast(QUIET, [strained, leaving(20.0)])[0] == strained


def test_the_cause_comes_first_whatever_the_order_of_the_library():
    course = course_of(Sums(LIBRARY), {GAIN: 1.0})
    assert single_looks(course, offer(course))[0].effects == ("gain",)


def test_a_look_is_taken_with_the_shape_that_suits_best():
    effect = fading("fading", "x")
    ((candidate, change),) = effect.items()
    several = replace(candidate, parameters=(candidate.parameters[0], rate((0.5, 8.0, 40.0))))
    truth = {Term("fading", "x", "amount"): 3.0, Term("fading", "x", "rate"): 7.0}
    course = course_of(Sums({several: change}), truth)
    (look,) = single_looks(course, offer(course))
    assert look.placed.blocks[0].start[1] == pytest.approx(np.log(8.0))


def test_beside_what_is_fitted_only_others_are_looked_at():
    course = course_of(Sums(LIBRARY), {GAIN: 1.0, ZERO: 0.5})
    (look,) = single_looks(course, offer(course), gain_alone(course))
    assert look.effects == ("gain", "zero")
    assert [block.place for block in look.placed.blocks] == ["a"]
    assert look.placed.coefficients == pytest.approx([0.5], abs=0.05)


def test_tolerances_fitted_before_are_not_counted_twice():
    """They are off by three deviations, and a look beside what knows of them sees that too."""
    off = {Term("scatter", "a", "amount"): 1.5, Term("scatter", "b", "amount"): -1.5}
    course = course_of(Sums(LIBRARY, scatter(0.5)), {GAIN: 1.0, ZERO: 0.5, **off})
    (look,) = single_looks(course, offer(course), gain_alone(course))
    assert look.placed.strain == pytest.approx(18.0, rel=0.1)
    assert look.placed.mean_square == pytest.approx(FLOOR**2, rel=0.3)


def test_two_effects_at_once_have_both_names():
    course = course_of(Sums(LIBRARY), {GAIN: 1.0, ZERO: 0.5})
    (look,) = joint_looks(course, offer(course), FLOOR**2)
    assert look.effects == ("gain", "zero")


def test_names_are_in_alphabetical_order():
    course = course_of(Sums(LIBRARY), {GAIN: 1.0})
    look = next(k for k in single_looks(course, offer(course)) if k.effects == ("zero",))
    assert replace(look, beside=explanation("aside", "zeal")).effects == ("aside", "zeal", "zero")


def test_what_leaves_far_more_than_the_best_is_given_up():
    looks = [leaving(1.0), leaving(2.0), leaving(30.0)]
    kept = list(promising(QUIET, looks, excess(1.0, FLOOR)))
    assert [look.placed for look in kept] == [look.placed for look in looks[:2]]


def test_a_fit_may_leave_more_than_the_best_look_yet_not_far_more():
    (kept,) = promising(QUIET, [leaving(1.0)], excess(1.0, FLOOR))
    assert 1.0 < kept.most_left < 10.0
