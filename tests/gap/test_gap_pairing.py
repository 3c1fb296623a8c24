"""Two effects looked at together are each found in their places."""

from __future__ import annotations

import numpy as np
import pytest
from gap_course import FLOOR, SIGNALS, TIME, Sums, amount, course_of, linear
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_gap.diagnosis.places import blocks
from cablesense_gap.diagnosis.screening import pair_looks

GAIN, ZERO = linear("gain", "abcd"), linear("zero", "abcd", SIGNALS[4:])
EVERYWHERE = linear("gain", ("arm", "a", "b", "c", "d"))
SIZES = st.sampled_from([-1.5, -0.4, 0.4, 2.0])


def looked_at(effects, truth, *, seed=0):
    simulator = Sums(effects)
    course = course_of(simulator, truth, seed)
    offered = {c.effect: blocks(course, c) for c in simulator.candidates}
    residual = course.readings - course.nominal
    return pair_looks(course, residual, offered, course.floor**2)


def found_in(placed):
    """Sizes by number, as the look has them."""
    terms = [block.terms[0] for block in placed.blocks]
    return dict(zip(terms, placed.coefficients, strict=True))


def planted(gains, zeros):
    return {amount("gain", p): v for p, v in gains.items()} | {
        amount("zero", p): v for p, v in zeros.items()
    }


@given(st.sampled_from("abcd"), st.sampled_from("abcd"), SIZES, SIZES, st.integers(0, 100))
@settings(max_examples=20, deadline=None)
def test_planted_pairs_are_found_with_both_places(one, other, gain, zero, seed):
    truth = planted({one: gain}, {other: zero})
    (placed,) = looked_at({**GAIN, **ZERO}, truth, seed=seed).values()
    assert found_in(placed) == pytest.approx(truth, abs=0.05)
    assert placed.mean_square == pytest.approx(FLOOR**2, rel=0.2)


@given(
    st.dictionaries(st.sampled_from("abcd"), SIZES, min_size=1, max_size=2),
    st.dictionaries(st.sampled_from("abcd"), SIZES, min_size=1, max_size=2),
)
@settings(max_examples=20, deadline=None)
def test_an_effect_may_sit_in_several_places(gains, zeros):
    """A place taken on the way there may stay, with next to nothing in it."""
    truth = planted(gains, zeros)
    (placed,) = looked_at({**GAIN, **ZERO}, truth).values()
    found = found_in(placed)
    assert found == pytest.approx({**dict.fromkeys(found, 0.0), **truth}, abs=0.05)


def test_what_is_everywhere_is_not_taken_apart():
    truth = planted({"arm": 0.5}, {"b": 1.0})
    (placed,) = looked_at({**EVERYWHERE, **ZERO}, truth).values()
    assert found_in(placed) == pytest.approx(truth, abs=0.05)


def test_what_is_nearly_the_same_everywhere_is_not_taken_apart():
    """Place by place explains a little more, beside something else that nothing explains."""
    truth = planted({"a": 0.56, "b": 0.44, "c": 0.55, "d": 0.45}, {"b": 1.0})
    teeth = 0.5 * np.outer(np.sin(40.0 * TIME), [1.0, 1.0, 1.0])
    uneven = teeth + Sums({**EVERYWHERE, **ZERO}).predict([truth])[0]
    (placed,) = looked_at({**EVERYWHERE, **ZERO}, uneven).values()
    assert set(found_in(placed)) == {amount("gain", "arm"), amount("zero", "b")}


@pytest.mark.parametrize("gains", [{"c": 0.5}, {"a": 0.5, "d": -0.8}])
def test_what_is_in_some_places_is_not_everywhere(gains):
    truth = planted(gains, {"b": 1.0})
    (placed,) = looked_at({**EVERYWHERE, **ZERO}, truth).values()
    assert found_in(placed) == pytest.approx(truth, abs=0.05)


def test_two_effects_are_seen_through_a_third_that_resembles_both():
    """Alone it explains more than either."""
    both = SIGNALS[1] + SIGNALS[6] + 0.5 * SIGNALS[3]
    library = {**linear("resembling", "a", [both]), **GAIN, **ZERO}
    found = looked_at(library, planted({"b": 1.0}, {"c": 1.0}))
    assert set(found) == {("resembling", "gain"), ("resembling", "zero"), ("gain", "zero")}
    least = min(found, key=lambda names: found[names].mean_square)
    assert least == ("gain", "zero")


def test_without_two_effects_there_is_nothing():
    course = course_of(Sums(GAIN), {})
    assert pair_looks(course, course.readings, {}, 1.0) == {}
    assert looked_at(GAIN, planted({"a": 1.0}, {})) == {}
    assert pair_looks(course, course.readings, {"gain": [()], "zero": [()]}, 1.0) == {}
