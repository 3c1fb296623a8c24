"""Fits of screened effects and pairs: starts, places chosen again, the final refinement."""

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

from cablesense_gap.diagnosis.fitting import fit, reselect_places
from cablesense_gap.diagnosis.gauss_newton import final_refinement, refine
from cablesense_gap.diagnosis.places import linear_effects
from cablesense_gap.diagnosis.screening import screen_pairs, screen_singles
from cablesense_gap.simulator import Candidate, Term

GAIN, AMOUNT, RATE = amount("gain", "b"), amount("fading", "x"), Term("fading", "x", "rate")
PLAIN = linear("gain", "abc")
((FADING, FADES),) = fading("fading", "xy", history_dependent=True).items()
TRIED = replace(FADING, parameters=(size("amount"), replace(rate(), trials=(1.0, 5.0, 25.0))))


def offered_for(library, truth):
    problem = problem_of(Sums(library), truth)
    return problem, {c.effect: linear_effects(problem, c) for c in problem.simulator.candidates}


def fitted(library, truth):
    problem, offered = offered_for(library, truth)
    return fit(problem, screen_singles(problem, offered)[0])


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
    problem, offered = offered_for({**PLAIN, TRIED: FADES}, truth)
    found = fit(problem, screen_pairs(problem, offered, FLOOR**2)[0])
    assert found.effects == ("fading", "gain")
    assert found.values == pytest.approx(truth, rel=0.1)


def test_beside_what_is_fitted_both_are_fitted_on():
    """The first alone was wrong, as the second was not there."""
    resembling = linear("gain", "ab", [SIGNALS[0], SIGNALS[1] + 0.7 * SIGNALS[6]])
    truth = {AMOUNT: 5.0, RATE: 5.0, GAIN: 1.0}
    problem, offered = offered_for({**resembling, TRIED: FADES}, truth)
    first = fit(
        problem, next(k for k in screen_singles(problem, offered) if "fading" in k.effects)
    )
    assert first.values[RATE] < 4.0
    (second,) = screen_singles(problem, offered, first)
    assert fit(problem, second).values == pytest.approx(truth, rel=0.1)


def test_where_every_start_leaves_too_much_there_is_no_fit():
    problem, offered = offered_for({TRIED: FADES}, {AMOUNT: 6.0, RATE: 6.0})
    screened = screen_singles(problem, offered)[0]
    assert fit(problem, replace(screened, most_left=1e-6)) is None
    assert (
        fit(problem, replace(screened, most_left=screened.placed.mean_square * 10.0)) is not None
    )


TWO_EFFECTS = {**linear("gain", "abcd"), **linear("zero", "abc", SIGNALS[4:])}
A, B, C, D = (amount("gain", place) for place in "abcd")
ZERO_A, ZERO_B, ZERO_C = (amount("zero", place) for place in "abc")
EACH = st.sampled_from([-1.5, -0.5, 0.5, 2.0])


def rethought(truth, terms, offered=("gain", "zero")):
    """Second thoughts on an explanation that was fitted with these terms."""
    problem = problem_of(Sums(TWO_EFFECTS), truth)
    before = refine(problem, {term: size("amount") for term in terms}, [[0.5] * len(terms)])
    by_name = {c.effect: linear_effects(problem, c) for c in problem.simulator.candidates}
    after = reselect_places(problem, before, {name: by_name[name] for name in offered})
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


@pytest.mark.slow
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
    smooth, about = final_refinement(problem, rough)
    assert not np.allclose(about.tolerance_columns, problem.tolerance_columns)
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
