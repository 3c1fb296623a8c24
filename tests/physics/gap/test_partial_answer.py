"""The certain part of an explanation, beside something that no list has."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_gap.diagnosis.extent import Extent, over_all_readings, without_extent
from cablesense_gap.diagnosis.fitting import refit
from cablesense_gap.diagnosis.probability import (
    bundled_calibration,
    posterior,
    posterior_beside_unlisted,
    probability_of_unlisted,
    probability_unlisted,
)
from cablesense_gap.diagnosis.search import search
from cablesense_gap.partial_answer import partial_answer
from tests.helpers.gap_problem import (
    CHANNELS,
    FLOOR,
    SIGNALS,
    TRIAL,
    TRIALS,
    Sums,
    amount,
    hypothesis,
    linear,
    problem_of,
)

BUNDLED = bundled_calibration()
LIBRARY = linear("gain", "abc") | linear("other", "ab", SIGNALS[3:])
LISTED = {amount("gain", "b"): 1.0}
UNLISTED = 30.0 * FLOOR * np.random.default_rng(11).normal(size=(len(TRIAL), CHANNELS))
"""No signal of the library."""
MACHINE = SimpleNamespace(
    channel_groups=lambda: np.arange(CHANNELS), completed=lambda _problem, found: list(found)
)


def problem_with(truth, unlisted):
    simulator = Sums(LIBRARY)
    return problem_of(simulator, simulator.predict([truth])[0] + unlisted)


def answered(truth, unlisted):
    problem = problem_with(truth, unlisted)
    ranked = posterior(search(problem), problem.floor, BUNDLED)
    return partial_answer(MACHINE, problem, ranked, BUNDLED)


def in_channel(channel):
    return UNLISTED * (np.arange(CHANNELS) == channel)


def in_trial(trial):
    return UNLISTED * (trial == TRIAL)[:, None]


@pytest.mark.parametrize("channel", range(CHANNELS))
def test_a_listed_effect_is_certain_although_one_channel_has_more(channel):
    answer = answered(LISTED, in_channel(channel))
    named = answer.ranked[0]
    assert named.effects == ("gain",)
    assert named.remainder
    assert sum(r.probability for r in answer.ranked if "gain" in r.effects) > 0.8
    assert answer.extent.channels.tolist() == [c == channel for c in range(CHANNELS)]
    assert named.hypothesis.values[amount("gain", "b")] == pytest.approx(1.0, abs=0.05)
    assert answer.explains_the_rest(BUNDLED)


def test_a_listed_effect_is_certain_although_one_trial_has_more():
    answer = answered(LISTED, 3.0 * in_trial(4))
    assert answer.ranked[0].effects == ("gain",)
    assert np.flatnonzero(answer.extent.trials).tolist() == [4]


def test_nothing_is_certain_where_nothing_listed_acts():
    for unlisted in (in_channel(1), in_trial(4), UNLISTED):
        assert answered({}, unlisted) is None


def test_probabilities_of_the_whole_add_up_to_one():
    answer = answered(LISTED, in_channel(0))
    assert sum(r.probability for r in answer.ranked) == pytest.approx(1.0)
    assert min(r.probability for r in answer.ranked) >= 0.0


def test_a_hypothesis_of_some_readings_predicts_the_others_as_unseen():
    """Its numbers are those of the readings it was fitted to; the rest has no say in them."""
    extent = Extent(np.arange(CHANNELS) == 2, np.arange(TRIALS) == 5, 1)
    seen = ~extent.readings(problem_with({}, 0.0))
    fits = []
    for unlisted in (0.0, UNLISTED * ~seen):
        problem = problem_with(LISTED, unlisted)
        fitted = refit(without_extent(problem, extent), LISTED, 4)
        whole = over_all_readings(problem, extent, fitted)
        assert whole.values == fitted.values
        fits.append(whole)
    assert fits[0].held_out == pytest.approx(fits[1].held_out)
    assert fits[0].prediction == pytest.approx(fits[1].prediction)
    gain = SIGNALS[1]
    off = (fits[1].held_out_effects - gain)[~seen]
    assert np.sqrt((off**2).mean()) < FLOOR


def test_what_is_left_at_the_floor_is_nothing_unlisted_and_many_floors_are():
    probabilities = [
        probability_unlisted(k * FLOOR, FLOOR, BUNDLED) for k in (0.5, 1.0, 2.5, 30.0)
    ]
    assert probabilities == sorted(probabilities)
    assert probabilities[1] < 0.1
    assert probabilities[2] > 0.5


@given(st.floats(1.0, 50.0), st.lists(st.floats(0.05, 1.0), min_size=1, max_size=3))
@settings(deadline=None, max_examples=20)
def test_beside_something_unlisted_the_effects_that_explain_more_are_more_probable(floors, shares):
    none = hypothesis(left=floors * FLOOR)
    listed = [
        hypothesis(name, left=floors * FLOOR * share)
        for name, share in zip("abc", shares, strict=False)
    ]
    ranked = posterior_beside_unlisted([none, *listed], FLOOR, BUNDLED)
    assert sum(r.probability for r in ranked) == pytest.approx(1.0)
    probability_of = {r.effects: r.probability for r in ranked}
    ordered = sorted(listed, key=lambda h: -h.held_out_rmse)
    probabilities = [probability_of[h.effects] for h in ordered]
    assert probabilities == sorted(probabilities)
    alone = probability_of_unlisted([none], FLOOR, BUNDLED)
    assert 0.0 < alone < 1.0
