"""Fits of additions: where they start, and the final refinement."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap_problem import (
    FLOOR,
    SIGNALS,
    TIME,
    Sums,
    amount,
    fading,
    linear,
    problem_of,
    rate,
    scatter,
    size,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_gap.diagnosis.columns import linear_effects
from cablesense_gap.diagnosis.fitting import fit
from cablesense_gap.diagnosis.gauss_newton import final_refinement, refine
from cablesense_gap.diagnosis.selection import Selection
from cablesense_gap.simulator import Candidate, Term

GAIN, AMOUNT, RATE = amount("gain", "b"), amount("fading", "x"), Term("fading", "x", "rate")
PLAIN = linear("gain", "abc")
((FADING, FADES),) = fading("fading", "xy", history_dependent=True).items()
TRIED = replace(FADING, parameters=(size("amount"), replace(rate(), trials=(1.0, 5.0, 25.0))))


def proposed(library, truth, about=None):
    problem = problem_of(Sums(library), truth)
    about = about or refine(problem, {}, [[]])
    offered = [e for c in problem.simulator.candidates for e in linear_effects(problem, c)]
    others = [e for e in offered if e.effect not in about.effects]
    return problem, Selection(problem, about, others).additions()


def fitted(library, truth, about=None):
    problem, proposals = proposed(library, truth, about)
    return min(fit(problem, proposals[0]), key=problem.judged)


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
def test_history_dependent_effects_are_found_from_another_shape(effect, planted):
    """The look is taken with a rate of two."""
    found = fitted({effect: FADES}, {AMOUNT: 6.0, RATE: planted})
    assert found.values[RATE] == pytest.approx(planted, rel=0.15)
    assert found.values[AMOUNT] == pytest.approx(6.0, rel=0.15)


def test_a_shape_is_begun_where_it_explains_most():
    """A tone is found from near its frequency alone, and a first look is not near."""
    shape = replace(rate((3.0,)), high=200.0, trials=(3.0, 12.0, 50.0))
    candidate = Candidate("tone", ("x",), (size("amount", 10.0), shape), history_dependent=True)

    def tone(_, numbers):
        return numbers["amount"] * np.outer(np.sin(numbers["rate"] * TIME), [1.0, 2.0, 3.0])

    size_, rate_ = candidate.terms("x")
    found = fitted({candidate: tone}, {size_: 2.0, rate_: 48.0})
    assert found.values[rate_] == pytest.approx(48.0, rel=0.05)


def test_what_saturates_is_begun_smaller_too():
    """From where the look ends there is no slope to go down."""
    candidate = Candidate("saturating", ("x",), (size("amount"),), history_dependent=True)
    effect = {candidate: lambda _, numbers: np.tanh(3.0 * numbers["amount"]) * SIGNALS[0]}
    truth = {amount("saturating", "x"): 0.3}
    assert fitted(effect, truth).values == pytest.approx(truth, rel=0.1)


def test_a_pair_has_its_planted_numbers():
    truth = {GAIN: 1.0, AMOUNT: 5.0, RATE: 5.0}
    found = fitted({**PLAIN, TRIED: FADES}, truth)
    assert found.effects == ("fading", "gain")
    assert found.values == pytest.approx(truth, rel=0.1)


def test_what_is_added_to_and_what_is_added_are_fitted_together():
    """The first alone was wrong, because the second was missing."""
    resembling = linear("gain", "ab", [SIGNALS[0], SIGNALS[1] + 0.7 * SIGNALS[6]])
    truth = {AMOUNT: 5.0, RATE: 5.0, GAIN: 1.0}
    problem, proposals = proposed({**resembling, TRIED: FADES}, truth)
    alone = next(p for p in proposals if p.effects == ("fading",))
    first = min(fit(problem, alone), key=problem.judged)
    assert first.values[RATE] < 4.0
    found = fitted({**resembling, TRIED: FADES}, truth, first)
    assert found.values == pytest.approx(truth, rel=0.1)


def test_where_every_start_leaves_too_much_there_is_no_fit():
    problem, proposals = proposed({TRIED: FADES}, {AMOUNT: 6.0, RATE: 6.0})
    assert fit(problem, replace(proposals[0], most_left=1e-6)) == []
    assert fit(problem, replace(proposals[0], most_left=1e3)) != []


COUPLED_GAIN, OFF = amount("gain", "a"), amount("scatter", "b")


class Coupled(Sums):
    """What a tolerance changes grows with the effect, as it does where an effect is large."""

    def _one(self, variant):
        gain, off = variant.get(COUPLED_GAIN, 0.0), variant.get(OFF, 0.0)
        return super()._one(variant) + 40.0 * gain * off * SIGNALS[3]


def fitted_coupled(problem):
    parameter = problem.simulator.candidates[0].parameters[0]
    found = refine(problem, {COUPLED_GAIN: parameter}, [[2.0]])
    assert found is not None
    return found


def coupled():
    return problem_of(Coupled(linear("gain", ["a"]), scatter()), {COUPLED_GAIN: 2.0, OFF: 0.05})


def test_tolerances_are_taken_as_they_act_beside_the_effect():
    problem = coupled()
    rough = fitted_coupled(problem)
    smooth, columns = final_refinement(problem, rough)
    assert not np.allclose(columns, problem.tolerance_columns)
    assert rough.held_out_rmse > 10.0 * FLOOR
    assert smooth.held_out_rmse < 1.1 * FLOOR
    assert smooth.values[COUPLED_GAIN] == pytest.approx(2.0, abs=0.02)
    assert smooth.tolerances[OFF] == pytest.approx(0.05, rel=0.5)


def test_a_fit_that_is_as_good_as_can_be_stays():
    problem = problem_of(Sums(linear("gain", ["a"])), {COUPLED_GAIN: 1.0})
    before = fitted_coupled(problem)
    after, _ = final_refinement(problem, before)
    assert after.values[COUPLED_GAIN] == pytest.approx(before.values[COUPLED_GAIN], abs=1e-3)
    assert problem.cost_of(after) <= problem.cost_of(before)


def test_tolerances_alone_need_no_polish():
    problem = coupled()
    none = refine(problem, {}, [[]])
    assert final_refinement(problem, none)[0] is none


def test_a_mechanism_that_cannot_be_simulated_there_keeps_its_old_fit():
    class Fragile(Coupled):
        def _one(self, variant):
            broken = COUPLED_GAIN in variant and OFF in variant
            return np.nan * SIGNALS[0] if broken else super()._one(variant)

    problem = problem_of(Fragile(linear("gain", ["a"]), scatter()), SIGNALS[0])
    before = fitted_coupled(problem)
    assert problem.cost_of(final_refinement(problem, before)[0]) <= problem.cost_of(before)
