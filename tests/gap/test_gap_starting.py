"""From a first look, a fit comes to the planted numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap_course import FLOOR, SIGNALS, TIME, Sums, amount, course_of, fading, linear, rate, size
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_gap.diagnosis.fitting import fit
from cablesense_gap.diagnosis.places import blocks
from cablesense_gap.diagnosis.screening import joint_looks, single_looks
from cablesense_gap.simulator import Candidate, Term

GAIN, AMOUNT, RATE = amount("gain", "b"), amount("fading", "x"), Term("fading", "x", "rate")
PLAIN = linear("gain", "abc")
((FADING, FADES),) = fading("fading", "xy", remembers=True).items()
TRIED = replace(FADING, parameters=(size("amount"), replace(rate(), trials=(1.0, 5.0, 25.0))))


def looks_at(library, truth):
    course = course_of(Sums(library), truth)
    return course, {c.effect: (c, blocks(course, c)) for c in course.simulator.candidates}


def fitted(library, truth):
    course, offered = looks_at(library, truth)
    return fit(course, single_looks(course, offered)[0])


@given(st.floats(0.3, 20.0), st.booleans())
@settings(max_examples=15, deadline=None)
def test_a_plain_effect_has_its_planted_number(value, negative):
    truth = {GAIN: -value if negative else value}
    found = fitted(PLAIN, truth)
    assert found.values == pytest.approx(truth, abs=0.02)
    assert found.held_out_rmse == pytest.approx(FLOOR, rel=0.15)


def test_an_effect_may_be_in_two_places():
    truth = {GAIN: 1.0, amount("gain", "c"): -0.6}
    assert fitted(PLAIN, truth).values == pytest.approx(truth, abs=0.02)


@pytest.mark.parametrize("effect", [FADING, TRIED], ids=["one shape", "several shapes"])
@pytest.mark.parametrize("planted", [0.7, 6.0, 20.0])
def test_what_remembers_is_found_from_another_shape(effect, planted):
    """The look is taken with a rate of two."""
    found = fitted({effect: FADES}, {AMOUNT: 6.0, RATE: planted})
    assert found.values[RATE] == pytest.approx(planted, rel=0.15)
    assert found.values[AMOUNT] == pytest.approx(6.0, rel=0.15)


def test_a_shape_is_begun_where_it_explains_most():
    """A tone is found from near its frequency alone, and a first look is not near."""
    shape = replace(rate((3.0,)), high=200.0, trials=(3.0, 12.0, 50.0))
    candidate = Candidate("tone", ("x",), (size("amount", 10.0), shape), remembers=True)

    def tone(_, numbers):
        return numbers["amount"] * np.outer(np.sin(numbers["rate"] * TIME), [1.0, 2.0, 3.0])

    size_, rate_ = candidate.terms("x")
    found = fitted({candidate: tone}, {size_: 2.0, rate_: 48.0})
    assert found.values[rate_] == pytest.approx(48.0, rel=0.05)


def test_what_saturates_is_begun_smaller_too():
    """From where the look ends there is no slope to go down."""
    candidate = Candidate("saturating", ("x",), (size("amount"),), remembers=True)
    effect = {candidate: lambda _, numbers: np.tanh(3.0 * numbers["amount"]) * SIGNALS[0]}
    truth = {amount("saturating", "x"): 0.3}
    assert fitted(effect, truth).values == pytest.approx(truth, rel=0.1)


def test_a_pair_has_its_planted_numbers():
    truth = {GAIN: 1.0, AMOUNT: 5.0, RATE: 5.0}
    course, offered = looks_at({**PLAIN, TRIED: FADES}, truth)
    found = fit(course, joint_looks(course, offered, FLOOR**2)[0])
    assert found.effects == ("fading", "gain")
    assert found.values == pytest.approx(truth, rel=0.1)


def test_beside_what_is_fitted_both_are_fitted_on():
    """The first alone was wrong, as the second was not there."""
    resembling = linear("gain", "ab", [SIGNALS[0], SIGNALS[1] + 0.7 * SIGNALS[6]])
    truth = {AMOUNT: 5.0, RATE: 5.0, GAIN: 1.0}
    course, offered = looks_at({**resembling, TRIED: FADES}, truth)
    first = fit(course, next(k for k in single_looks(course, offered) if "fading" in k.effects))
    assert first.values[RATE] < 4.0
    (second,) = single_looks(course, offered, first)
    assert fit(course, second).values == pytest.approx(truth, rel=0.1)


def test_where_every_start_leaves_too_much_there_is_no_fit():
    course, offered = looks_at({TRIED: FADES}, {AMOUNT: 6.0, RATE: 6.0})
    look = single_looks(course, offered)[0]
    assert fit(course, replace(look, most_left=1e-6)) is None
    assert fit(course, replace(look, most_left=look.placed.mean_square * 10.0)) is not None
