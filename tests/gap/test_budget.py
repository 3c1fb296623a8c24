"""The budget of a gap, against sizes that follow from what was planted."""

from __future__ import annotations

import numpy as np
import pytest
from gap_problem import FLOOR, SIGNALS, Sums, amount, linear, problem_of

from cablesense_gap.diagnosis.gauss_newton import refine, refit
from cablesense_gap.diagnosis.probability import Ranked
from cablesense_gap.explained import remainder, shares, trades

TRUTH = {amount("gain", "b"): 2.0, amount("other", "a"): -0.7}
PLANTED = {
    "gain": 2.0 * SIGNALS[1],
    "other": -0.7 * SIGNALS[4],
}


def size_of(values):
    return float(np.sqrt((values**2).mean()))


@pytest.fixture(scope="module")
def problem():
    return problem_of(Sums(linear("gain", "abc") | linear("other", "ab", SIGNALS[4:])), TRUTH)


@pytest.fixture(scope="module")
def budget(problem):
    best, rival = refit(problem, TRUTH, 4), refit(problem, {amount("gain", "b"): 2.0}, 4)
    ranked = [Ranked(best.effects, 0.8, best), Ranked(rival.effects, 0.15, rival)]
    return shares(problem, ranked, best.values)


def test_a_share_is_what_predictions_change_without_the_effect(budget):
    assert list(budget) == ["gain", "other"]
    for effect, planted in PLANTED.items():
        assert budget[effect].share_n == pytest.approx(size_of(planted), rel=0.03)
        low, high = budget[effect].ci95_n
        assert low < size_of(planted) < high


def test_the_steps_lead_from_the_gap_to_the_floor(budget):
    assert budget["gain"].left_n == pytest.approx(
        np.hypot(size_of(PLANTED["other"]), FLOOR), rel=0.1
    )
    assert budget["other"].left_n == pytest.approx(FLOOR, rel=0.1)


def test_an_effect_is_as_probable_as_all_explanations_that_have_it(budget):
    assert budget["gain"].probability == pytest.approx(0.95)
    assert budget["other"].probability == pytest.approx(0.8)


def test_what_no_effect_explains_is_stated(problem):
    explained = remainder(problem, refit(problem, TRUTH, 4))
    assert explained.share < 0.05
    half = remainder(problem, refit(problem, {amount("gain", "b"): 2.0}, 4))
    assert half.unexplained == pytest.approx(size_of(PLANTED["other"]), rel=0.1)
    nothing = remainder(problem, refine(problem, {}, [[]]))
    assert nothing.share == pytest.approx(1.0, abs=0.05)


NEAR = SIGNALS[1] + 0.05 * SIGNALS[5]


def fitted_together(second):
    """What `gain` at b and an effect of another signal make of a mixture of the two."""
    truth = {amount("gain", "b"): 0.5, amount("other", "a"): 0.4}
    problem = problem_of(
        Sums(linear("gain", "b", [SIGNALS[1]]) | linear("other", "a", [second])), truth
    )
    return problem, refit(problem, truth, 4)


def test_effects_that_one_recording_hardly_parts_are_one_item():
    problem, best = fitted_together(NEAR)
    (trade,) = trades(problem, best)
    traded = trade.traded
    assert traded.effects == ("gain", "other")
    assert traded.correlation < -0.9
    together = size_of(0.5 * SIGNALS[1] + 0.4 * NEAR)
    assert traded.ci95_n[0] < together < traded.ci95_n[1]
    assert traded.ci95_n[1] - traded.ci95_n[0] < 0.2 * together
    # other numbers of both, and yet nearly the same predictions
    moved = problem.simulator.predict([trade.elsewhere])[0] - best.without_tolerances
    assert size_of(moved) < 0.2 * together
    assert abs(trade.elsewhere[amount("other", "a")] - best.values[amount("other", "a")]) > 0.05


def test_effects_of_different_signals_do_not_trade():
    assert trades(*fitted_together(SIGNALS[5])) == []
