"""Planted places are found, and no others."""

from __future__ import annotations

import numpy as np
import pytest
from gap_course import SIGNALS, TRIAL, Sums, amount, course_of, linear
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_gap.diagnosis.places import blocks, place

PLACES = tuple("abcdefgh")
SPREAD = linear("gain", PLACES)
NOTHING = np.empty((0, *SIGNALS[0].shape))


def placed(effects, truth, *, beside=NOTHING, seed=0):
    simulator = Sums(effects)
    course = course_of(simulator, truth, seed)
    offered = blocks(course, simulator.candidates[0])[0]
    return place(course, course.readings - course.nominal, beside, offered)[0]


def places(found):
    return {block.place for block in found.blocks}


@given(
    st.dictionaries(st.sampled_from(PLACES), st.sampled_from([-1.5, -0.4, 0.3, 2.0]), min_size=1,
                    max_size=4),
    st.integers(0, 100),
)  # fmt: skip
@settings(max_examples=25, deadline=None)
def test_planted_places_are_found_and_no_others(truth, seed):
    found = placed(SPREAD, {amount("gain", p): value for p, value in truth.items()}, seed=seed)
    assert places(found) == set(truth)
    for block, coefficient in zip(found.blocks, found.coefficients, strict=True):
        assert coefficient == pytest.approx(truth[block.place], abs=0.05)


def test_the_first_place_is_the_one_that_explains_most():
    found = placed(SPREAD, {amount("gain", "c"): 0.3, amount("gain", "f"): 2.0})
    assert [block.place for block in found.blocks] == ["f", "c"]


@pytest.mark.parametrize("seed", range(5))
def test_noise_gets_one_place_and_no_more(seed):
    assert len(placed(SPREAD, {}, seed=seed).blocks) == 1


def test_what_is_everywhere_is_not_taken_apart():
    everywhere = linear("gain", ("arm", *PLACES[:4]))
    found = placed(everywhere, {amount("gain", "arm"): 0.5})
    assert places(found) == {"arm"}
    assert found.coefficients == pytest.approx([0.5], abs=0.02)


def test_what_is_in_one_place_is_not_everywhere():
    everywhere = linear("gain", ("arm", *PLACES[:4]))
    assert places(placed(everywhere, {amount("gain", "b"): 0.5})) == {"b"}


def test_what_is_left_is_the_noise_where_the_effect_is_the_cause():
    found = placed(SPREAD, {amount("gain", "d"): 1.0})
    assert found.mean_square == pytest.approx(0.1**2, rel=0.15)
    assert found.squares.shape == (12,)
    assert found.squares.sum() == pytest.approx(found.mean_square * SIGNALS[0].size)


def test_what_other_effects_explain_is_not_counted_twice():
    """Beside an effect that is there already, only what it leaves is to be explained."""
    truth = 3.0 * SIGNALS[7] + 0.5 * SIGNALS[1]
    alone = placed(linear("gain", PLACES[:4]), truth)
    beside = placed(linear("gain", PLACES[:4]), truth, beside=SIGNALS[7:8])
    assert places(beside) == {"b"}
    assert beside.coefficients == pytest.approx([0.5], abs=0.05)
    assert beside.mean_square < 0.1 * alone.mean_square


def test_without_a_place_there_is_nothing():
    course = course_of(Sums(SPREAD), {})
    assert place(course, course.readings, NOTHING, []) == []


def test_a_place_that_explains_nearly_as_much_follows():
    """Two signals that are all but parallel, and a third that is not."""
    signals = np.array([SIGNALS[0], SIGNALS[0] + 0.03 * SIGNALS[1], SIGNALS[2]])
    simulator = Sums(linear("gain", "abc", signals))
    course = course_of(simulator, {amount("gain", "a"): 1.0})
    offered = blocks(course, simulator.candidates[0])[0]
    best, second = place(course, course.readings, NOTHING, offered)
    assert places(best) == {"a"}
    assert places(second) == {"b"}
    assert second.mean_square >= best.mean_square


def test_what_holds_in_one_trial_alone_is_no_place():
    """It fits what it was fitted to, and fails on all trials that were held out."""
    once = np.array([SIGNALS[0], SIGNALS[1] * (TRIAL == 3)[:, None]])
    effects = linear("gain", ("a", "b"), once)
    assert places(placed(effects, {amount("gain", "a"): 1.0, amount("gain", "b"): 1.0})) == {"a"}


def test_two_places_of_which_either_alone_explains_nothing_are_found_together():
    """Two cables that pull against each other: their difference is all that is seen."""
    alike = SIGNALS[0] + SIGNALS[1]
    signals = np.array([10.0 * alike + SIGNALS[2], -10.0 * alike, SIGNALS[3], SIGNALS[4]])
    truth = {amount("gain", "a"): 1.0, amount("gain", "b"): 1.0, amount("gain", "c"): 3.0}
    found = placed(linear("gain", "abcd", signals), truth)
    assert places(found) == {"a", "b", "c"}
