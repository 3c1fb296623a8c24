"""Effects added, exchanged and left out, beside each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap_problem import (
    FLOOR,
    SIGNALS,
    Sums,
    amount,
    linear,
    problem_of,
    several,
    size,
)

from cablesense_gap.diagnosis.fitting import fit
from cablesense_gap.diagnosis.gauss_newton import refine, refit
from cablesense_gap.diagnosis.joint_selection import JointSelection, borne_out
from cablesense_gap.diagnosis.places import linear_effects
from cablesense_gap.simulator import Candidate


def test_a_wrong_effect_is_replaced_by_the_right_one():
    library = several(4)
    right, wrong = (amount(name, "b") for name in "eg")
    problem = problem_of(Sums(library), {amount("d", "a"): 2.0, right: 1.0})
    start = refit(problem, {amount("d", "a"): 1.0, wrong: 0.5}, 4)
    selection = JointSelection(problem, per_item(problem), problem.simulator.candidates, fit, {})
    found = {h.effects: h for h in selection.replaced(start)}
    assert problem.cost_of(found["d", "e"]) < 0.1 * problem.cost_of(start)
    assert found["d", "e"].values == pytest.approx({amount("d", "a"): 2.0, right: 1.0}, abs=0.05)


def per_item(problem):
    """As the search spreads work, in this process."""
    return lambda function, values: (function(problem, each) for each in values)


def test_of_four_alike_none_is_missed():
    """The first of them takes away an eighth of what is left, less than it would cost alone."""
    simulator = Sums(several(5))
    truth = {amount(name, "b"): 1.0 for name in "defg"}
    problem = problem_of(simulator, truth)
    start = refine(problem, {}, [[]])
    selection = JointSelection(
        problem, lambda f, each: (f(problem, x) for x in each), simulator.candidates, fit, {}
    )
    *_, found = selection.run(start, lambda h: h.held_out_rmse < 1.1 * FLOOR, lambda _: False)
    assert found.values == pytest.approx(truth, abs=0.05)


def selected(problem, values):
    """What the selection ends with from these values on."""
    every = problem.simulator.candidates
    selection = JointSelection(problem, per_item(problem), every, fit, {})
    start = refit(problem, values, 4)
    *_, found = [start, *selection.run(start, lambda _: False, lambda _: False)]
    return found


def unlike(count, seed):
    return np.random.default_rng(seed).normal(size=(count, *SIGNALS.shape[1:]))


def test_an_effect_in_most_of_its_places_is_one_choice():
    """Ten choices of one place each would be refused, beside what nothing explains."""
    places = [f"p{k}" for k in range(12)]
    simulator = Sums(linear("gain", "ab") | linear("drift", places, unlike(12, 1)))
    truth = {amount("gain", "b"): 3.0} | {amount("drift", place): 1.0 for place in places[:10]}
    unexplained = 1.3 * unlike(1, 2)[0]
    problem = problem_of(simulator, simulator.predict([truth])[0] + unexplained)
    assert set(selected(problem, {amount("gain", "b"): 3.0}).values) == truth.keys()


class Masked(Sums):
    """Beside the wrong effect the right one shows nothing."""

    def _one(self, variant):
        wrong = any(term.effect == "wrong" for term in variant)
        return super()._one({t: v for t, v in variant.items() if not (wrong and t.effect == "e")})


def test_what_is_needed_most_may_be_the_wrong_effect():
    """It imitates nearly all of what the right one does: nothing else is missed as much."""
    right, other = unlike(2, 3)
    library = linear("e", "a", [right]) | linear("wrong", "a", [right + 0.2 * other])
    problem = problem_of(Masked(library), {amount("e", "a"): 5.0})
    cheap, known = problem.simulator.candidates[1:], problem.simulator.candidates[0]
    selection = JointSelection(
        problem, per_item(problem), cheap, fit, {"e": linear_effects(problem, known)}
    )
    start = refit(problem, {amount("wrong", "a"): 5.0}, 4)
    assert problem.cost_of(refit(problem, {}, 0)) > 3.0 * problem.cost_of(start)
    *_, found = selection.run(start, lambda _: False, lambda _: False)
    assert found.values == pytest.approx({amount("e", "a"): 5.0}, abs=0.05)


def test_a_size_that_cannot_be_is_no_place():
    """The signal of "a" would need to be taken away, which it cannot be."""
    candidate = Candidate("load", ("a", "b"), (replace(size("amount"), low=0.0),))
    by_place = dict(zip("ab", SIGNALS, strict=False))
    simulator = Sums({candidate: lambda place, numbers: numbers["amount"] * by_place[place]})
    problem = problem_of(simulator, 2.0 * SIGNALS[1] - 3.0 * SIGNALS[0])
    selection = JointSelection(
        problem, lambda f, each: (f(problem, x) for x in each), simulator.candidates, fit, {}
    )
    start = refine(problem, {}, [[]])
    *_, found = selection.run(start, lambda _: False, lambda _: False)
    assert set(found.values) == {amount("load", "b")}


def test_a_gain_in_one_trial_of_many_may_be_chance():
    truth = {amount("d", "b"): 1.0}
    whole = refit(problem_of(Sums(several(1)), truth), truth, 1)
    lucky = np.zeros(len(whole.squares))
    lucky[3] = whole.squares.sum()
    assert not borne_out(whole, replace(whole, squares=whole.squares + lucky))
    assert borne_out(whole, replace(whole, squares=2.0 * whole.squares))
