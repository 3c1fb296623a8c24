"""Explanations by listed effects, alone or beside something that no list has."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_gap.diagnosis.extent import Extent, over_all_readings, without_extent
from cablesense_gap.diagnosis.fitting import refit
from cablesense_gap.diagnosis.probability import (
    UNKNOWN_ALONE,
    Fits,
    bundled_calibration,
    log_weights_alone,
    log_weights_beside_unlisted,
    probability_unlisted,
)
from cablesense_gap.diagnosis.search import search
from cablesense_gap.explanations import explanations
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
    channel_groupings=lambda: (np.arange(CHANNELS),), completed=lambda _problem, found: list(found)
)


def problem_with(truth, unlisted):
    simulator = Sums(LIBRARY)
    return problem_of(simulator, simulator.predict([truth])[0] + unlisted)


def answered(truth, unlisted):
    problem = problem_with(truth, unlisted)
    return explanations(MACHINE, problem, search(problem), BUNDLED)


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
    assert answer.beside.extent.channels.tolist() == [c == channel for c in range(CHANNELS)]
    assert answer.unlisted > 0.9
    assert named.hypothesis.values[amount("gain", "b")] == pytest.approx(1.0, abs=0.05)
    assert answer.beside.nothing_elsewhere(BUNDLED)


def test_a_listed_effect_is_certain_although_one_trial_has_more():
    answer = answered(LISTED, 3.0 * in_trial(4))
    assert answer.ranked[0].effects == ("gain",)
    assert np.flatnonzero(answer.beside.extent.trials).tolist() == [4]


def test_nothing_listed_is_named_where_nothing_listed_acts():
    for unlisted in (in_channel(1), in_trial(4), UNLISTED):
        answer = answered({}, unlisted)
        assert answer.ranked[0].effects == UNKNOWN_ALONE
        assert answer.beside is None


def test_a_listed_effect_alone_stands_beside_nothing():
    answer = answered(LISTED, 0.0)
    assert answer.ranked[0].effects == ("gain",)
    assert answer.beside is None
    assert answer.unlisted < 0.1


def test_effects_that_explain_a_few_channels_alone_are_not_sure():
    """What acts in three of four channels may be imitated in the last one."""
    elsewhere = UNLISTED * (np.arange(CHANNELS) > 0)
    answer = answered(LISTED, elsewhere)
    assert sum(r.probability for r in answer.ranked if "gain" in r.effects) < 0.8


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
def test_beside_something_unlisted_effects_that_leave_less_weigh_more(floors, shares):
    none = hypothesis(left=floors * FLOOR)
    listed = [
        hypothesis(name, left=floors * FLOOR * share)
        for name, share in zip("abc", shares, strict=False)
    ]
    unlisted_rmse = np.array([h.held_out_rmse for h in [none, *listed]])
    weights = log_weights_beside_unlisted(
        Fits.of([none, *listed]), unlisted_rmse, 1.0, 0.0, FLOOR, BUNDLED
    )[1:]
    in_order = np.argsort([-h.held_out_rmse for h in listed])
    assert (np.diff(weights[in_order]) >= 0.0).all()


@given(st.floats(2.0, 50.0), st.floats(0.1, 0.9))
@settings(deadline=None, max_examples=20)
def test_an_extent_that_is_like_the_rest_says_no_more_than_all_readings(floors, share):
    """Without a choice, and with as much left inside as outside, only κ₀ differs."""
    gain = hypothesis("gain", left=floors * FLOOR)
    none = hypothesis(left=floors * FLOOR)
    unlisted_rmse = np.full(2, floors * FLOOR)

    def weight(share, log_choices):
        weights = log_weights_beside_unlisted(
            Fits.of([none, gain]), unlisted_rmse, share, log_choices, FLOOR, BUNDLED
        )
        return weights[1]

    alone = log_weights_alone([none, gain], FLOOR, BUNDLED)[1] - BUNDLED.unknown
    expected = (1.0 - share) * alone + share * weight(1.0, 0.0)
    assert weight(share, 0.0) == pytest.approx(expected)
    assert weight(share, 3.0) == pytest.approx(expected - 3.0)


def test_an_effect_that_removes_what_an_imitation_does_makes_no_unlisted_one_likelier():
    """Beside an unlisted effect that acts everywhere, and far beyond the floor."""
    none = hypothesis(left=1000.0 * FLOOR)
    imitation = hypothesis("gain", left=1000.0 * FLOOR * BUNDLED.share)
    unlisted_rmse = np.array([h.held_out_rmse for h in (none, imitation)])
    weights = log_weights_beside_unlisted(
        Fits.of([none, imitation]), unlisted_rmse, 1.0, 0.0, FLOOR, BUNDLED
    )
    expected = -BUNDLED.one - BUNDLED.size * imitation.sizes
    assert weights[1] - weights[0] == pytest.approx(expected, abs=1e-3)
