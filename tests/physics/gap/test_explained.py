"""Shares, trades, significant places and sizes of a gap, against what was planted."""

from __future__ import annotations

import numpy as np
import pytest

from cablesense_gap.diagnosis.fitting import refine, refit
from cablesense_gap.diagnosis.probability import Ranked
from cablesense_gap.explained import (
    Changes,
    gap_size,
    remainder,
    removes,
    rmse_interval_n,
    shares,
    trades,
)
from tests.helpers.gap_problem import FLOOR, SIGNALS, Sums, amount, linear, problem_of

TRUTH = {amount("gain", "b"): 2.0, amount("other", "a"): -0.7}
PLANTED = {"gain": 2.0 * SIGNALS[1], "other": -0.7 * SIGNALS[4]}


def size_of(values):
    return float(np.sqrt((values**2).mean()))


@pytest.fixture(scope="module")
def problem():
    return problem_of(Sums(linear("gain", "abc") | linear("other", "ab", SIGNALS[4:])), TRUTH)


def test_a_share_is_the_change_of_predictions_without_the_effect(problem):
    best = refit(problem, TRUTH, 4)
    rival = refit(problem, {amount("gain", "b"): 2.0}, 4)
    ranked = [Ranked(best.effects, 0.8, best), Ranked(rival.effects, 0.15, rival)]
    budget = shares(Changes(problem, best), ranked, best.values)
    assert list(budget) == ["gain", "other"]
    for effect, planted in PLANTED.items():
        assert budget[effect].share_n == pytest.approx(size_of(planted), rel=0.03)
        low, high = budget[effect].ci95_n
        assert low < size_of(planted) < high
    # the steps lead from the gap to the floor
    left_n = np.hypot(size_of(PLANTED["other"]), FLOOR)
    assert budget["gain"].left_n == pytest.approx(left_n, rel=0.1)
    assert budget["other"].left_n == pytest.approx(FLOOR, rel=0.1)
    assert budget["gain"].probability == pytest.approx(0.95)
    assert budget["other"].probability == pytest.approx(0.8)


def test_the_unexplained_part_is_stated(problem):
    assert remainder(problem, refit(problem, TRUTH, 4)).share < 0.05
    half = remainder(problem, refit(problem, {amount("gain", "b"): 2.0}, 4))
    assert half.unexplained == pytest.approx(size_of(PLANTED["other"]), rel=0.1)
    nothing = remainder(problem, refine(problem, {}, [[]]))
    assert nothing.share == pytest.approx(1.0, abs=0.05)


def test_effects_remove_something_or_are_not_named(problem):
    right = refit(problem, TRUTH, 4)
    assert removes(Changes(problem, right))
    # an effect that is not there, beside one that is: its share is within its own deviation
    idle = refit(problem, TRUTH | {amount("gain", "a"): 0.0, amount("gain", "c"): 0.0}, 4)
    assert removes(Changes(problem, idle))  # places of one effect count together
    smaller = {amount("other", "b"): 0.3}
    assert not removes(Changes(problem, refit(problem, smaller, 4)))


def test_a_size_that_may_be_zero_is_not_named():
    library = linear("gain", "b", [SIGNALS[1]]) | linear("other", "a", [SIGNALS[5]])
    problem = problem_of(Sums(library), {amount("gain", "b"): 0.5}, seed=4)
    with_other = refit(problem, {amount("gain", "b"): 0.5, amount("other", "a"): 0.001}, 4)
    fitted_size = abs(with_other.values[amount("other", "a")])
    assert fitted_size < with_other.deviations[amount("other", "a")]
    assert not removes(Changes(problem, with_other))
    assert removes(Changes(problem, refit(problem, {amount("gain", "b"): 0.5}, 4)))


NEAR = SIGNALS[1] + 0.05 * SIGNALS[5]


def fitted_together(second):
    """What `gain` at b and an effect of another signal make of a mixture of the two."""
    truth = {amount("gain", "b"): 0.5, amount("other", "a"): 0.4}
    problem = problem_of(
        Sums(linear("gain", "b", [SIGNALS[1]]) | linear("other", "a", [second])), truth
    )
    return problem, refit(problem, truth, 4)


def test_effects_that_one_recording_hardly_distinguishes_are_one_item():
    problem, best = fitted_together(NEAR)
    (trade,) = trades(Changes(problem, best))
    traded = trade.traded
    assert traded.effects == ("gain", "other")
    assert traded.correlation < -0.9
    together = size_of(0.5 * SIGNALS[1] + 0.4 * NEAR)
    assert traded.ci95_n[0] < together < traded.ci95_n[1]
    assert traded.ci95_n[1] - traded.ci95_n[0] < 0.2 * together
    # other numbers of both, with nearly the same predictions
    moved = problem.simulator.predict([trade.elsewhere])[0] - best.without_nuisance
    assert size_of(moved) < 0.2 * together
    assert abs(trade.elsewhere[amount("other", "a")] - best.values[amount("other", "a")]) > 0.05
    assert trades(Changes(*fitted_together(SIGNALS[5]))) == []


CABLES = 3
ROWS = 40
TRIALS = 20
TRIALS_OF = np.repeat(np.arange(TRIALS), ROWS)
RNG = np.random.default_rng(3)
WHITE = RNG.normal(size=(len(TRIALS_OF), CABLES))
ONES = np.ones_like(WHITE)


def test_sizes_are_root_mean_squares():
    by_cable = np.array([0.5, 1.0, 2.0])
    gap = gap_size(by_cable * ONES, 0.1 * ONES, TRIALS_OF, floor_n=0.1)
    assert gap.before_n == pytest.approx(np.sqrt((by_cable**2).mean()))
    assert gap.by_cable_n == pytest.approx(tuple(by_cable))
    assert (gap.after_n, gap.floor_n) == (pytest.approx(0.1), 0.1)
    assert gap.removed_fraction == pytest.approx(1.0)
    assert gap.ci95 == pytest.approx((1.0, 1.0))
    assert gap_size(2.0 * WHITE, WHITE, TRIALS_OF, 0.1) == gap_size(
        2.0 * WHITE, WHITE, TRIALS_OF, 0.1
    )


def test_the_interval_of_a_size_holds_it_as_often_as_it_says():
    held = 0
    for seed in range(50):
        rng = np.random.default_rng(seed)
        squares = (rng.normal(size=(30, 50)) ** 2).sum(1)
        low, high = rmse_interval_n(squares, np.full(30, 50.0))
        held += low <= 1.0 <= high
    assert 0.85 < held / 50 < 1.0
