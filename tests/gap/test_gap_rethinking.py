"""What was fitted in a wrong place is put right, and what does nothing is left out."""

from __future__ import annotations

import pytest
from gap_course import FLOOR, SIGNALS, Sums, amount, course_of, linear, size
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_gap.diagnosis.fitting import rethink
from cablesense_gap.diagnosis.gauss_newton import refine
from cablesense_gap.diagnosis.places import blocks

LIBRARY = {**linear("gain", "abcd"), **linear("zero", "abc", SIGNALS[4:])}
A, B, C, D = (amount("gain", place) for place in "abcd")
ZERO_A, ZERO_B, ZERO_C = (amount("zero", place) for place in "abc")
EACH = st.sampled_from([-1.5, -0.5, 0.5, 2.0])


def rethought(truth, terms, offered=("gain", "zero")):
    """Second thoughts on a hypothesis that was fitted with these terms."""
    course = course_of(Sums(LIBRARY), truth)
    before = refine(course, {term: size("amount") for term in terms}, [[0.5] * len(terms)])
    by_name = {c.effect: (c, blocks(course, c)) for c in course.simulator.candidates}
    after = rethink(course, before, {name: by_name[name] for name in offered})
    return before, after


@pytest.mark.parametrize("wrong", [(B, ZERO_A), (A, ZERO_C), (B, ZERO_C), (B, C, ZERO_B)])
def test_a_pair_in_wrong_places_is_put_right(wrong):
    truth = {A: 1.0, ZERO_A: -0.8}
    before, after = rethought(truth, wrong)
    assert after.values == pytest.approx(truth, abs=0.05)
    assert after.held_out_rmse == pytest.approx(FLOOR, rel=0.15)
    assert after.held_out_rmse < before.held_out_rmse


def test_a_missing_place_is_added():
    truth = {A: 1.0, C: 0.7, ZERO_A: -0.8}
    assert rethought(truth, [A, ZERO_A])[1].values == pytest.approx(truth, abs=0.05)


@pytest.mark.parametrize("idle", [[B], [C, D], [ZERO_B], [B, ZERO_C]])
def test_places_that_do_nothing_are_left_out(idle):
    truth = {A: 1.0, ZERO_A: -0.8}
    assert rethought(truth, [*truth, *idle])[1].values == pytest.approx(truth, abs=0.05)


def test_of_a_single_effect_too_places_that_do_nothing_are_left_out():
    assert set(rethought({A: 1.0}, [C, A, D])[1].values) == {A}


@given(
    st.dictionaries(st.sampled_from([A, B, C, D]), EACH, min_size=1),
    st.dictionaries(st.sampled_from([ZERO_A, ZERO_B, ZERO_C]), EACH, min_size=1),
)
@settings(max_examples=20, deadline=None)
def test_places_that_are_needed_stay(gains, zeros):
    truth = {**gains, **zeros}
    assert rethought(truth, truth)[1].values == pytest.approx(truth, abs=0.05)


def test_both_effects_stay_even_if_one_does_nothing():
    """Whether it is named is for others to say."""
    assert rethought({A: 1.0}, [A, ZERO_A])[1].effects == ("gain", "zero")


def test_an_effect_that_is_not_offered_stays_where_it_is():
    _, after = rethought({A: 1.0, ZERO_A: -0.8}, [B, ZERO_B], offered=["zero"])
    assert {term for term in after.values if term.effect == "gain"} == {B}
