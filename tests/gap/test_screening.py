"""Screening of one effect and of two: what comes first, and where each is found."""

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
    explanation,
    fading,
    linear,
    problem_of,
    rate,
    scatter,
    size,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_gap.diagnosis.gauss_newton import refine
from cablesense_gap.diagnosis.places import Placed, linear_effects
from cablesense_gap.diagnosis.problem import excess
from cablesense_gap.diagnosis.screening import (
    Screened,
    by_forecast,
    promising,
    screen_pairs,
    screen_singles,
)
from cablesense_gap.simulator import Term

LIBRARY = {**linear("zero", "ab", SIGNALS[3:]), **linear("gain", "abc")}
GAIN, ZERO = amount("gain", "b"), amount("zero", "a")
QUIET = problem_of(Sums(LIBRARY), {})


def offer(problem):
    return {c.effect: linear_effects(problem, c) for c in problem.simulator.candidates}


def leaving(rmse, tolerance_chi2=0.0):
    """A look at nothing in particular that leaves so much."""
    return Screened(Placed((), np.empty(0), rmse**2, tolerance_chi2))


def gain_alone(problem):
    found = refine(problem, {GAIN: size("amount")}, [[1.0]])
    assert found is not None
    return found


@given(st.lists(st.floats(0.2, 10.0), min_size=2, max_size=6))
@settings(deadline=None)
def test_what_leaves_least_comes_first(left):
    ordered = by_forecast(QUIET, [leaving(rmse) for rmse in left])
    assert [screened.placed.mean_square for screened in ordered] == sorted(
        rmse**2 for rmse in left
    )


def test_what_strains_tolerances_comes_later():
    strained, easy = leaving(1.0, tolerance_chi2=100.0), leaving(1.0, tolerance_chi2=1.0)
    assert by_forecast(QUIET, [strained, easy]) == [easy, strained]
    assert by_forecast(QUIET, [strained, leaving(20.0)])[0] == strained


def test_the_cause_comes_first_whatever_the_order_of_the_library():
    problem = problem_of(Sums(LIBRARY), {GAIN: 1.0})
    assert screen_singles(problem, offer(problem))[0].effects == ("gain",)


def test_a_look_is_taken_with_the_shape_that_suits_best():
    effect = fading("fading", "x")
    ((candidate, change),) = effect.items()
    several = replace(candidate, parameters=(candidate.parameters[0], rate((0.5, 8.0, 40.0))))
    truth = {Term("fading", "x", "amount"): 3.0, Term("fading", "x", "rate"): 7.0}
    problem = problem_of(Sums({several: change}), truth)
    (screened,) = screen_singles(problem, offer(problem))
    assert screened.placed.chosen[0].start[1] == pytest.approx(np.log(8.0))


def test_beside_what_is_fitted_only_others_are_screened_pairs():
    problem = problem_of(Sums(LIBRARY), {GAIN: 1.0, ZERO: 0.5})
    (screened,) = screen_singles(problem, offer(problem), gain_alone(problem))
    assert screened.effects == ("gain", "zero")
    assert [block.place for block in screened.placed.chosen] == ["a"]
    assert screened.placed.coefficients == pytest.approx([0.5], abs=0.05)


def test_tolerances_fitted_before_are_not_counted_twice():
    """They are off by three deviations, and a look beside what knows of them sees that too."""
    off = {Term("scatter", "a", "amount"): 1.5, Term("scatter", "b", "amount"): -1.5}
    problem = problem_of(Sums(LIBRARY, scatter(0.5)), {GAIN: 1.0, ZERO: 0.5, **off})
    (screened,) = screen_singles(problem, offer(problem), gain_alone(problem))
    assert screened.placed.tolerance_chi2 == pytest.approx(18.0, rel=0.1)
    assert screened.placed.mean_square == pytest.approx(FLOOR**2, rel=0.3)


def test_two_effects_at_once_have_both_names():
    problem = problem_of(Sums(LIBRARY), {GAIN: 1.0, ZERO: 0.5})
    (screened,) = screen_pairs(problem, offer(problem), FLOOR**2)
    assert screened.effects == ("gain", "zero")


def test_names_are_in_alphabetical_order():
    problem = problem_of(Sums(LIBRARY), {GAIN: 1.0})
    screened = next(k for k in screen_singles(problem, offer(problem)) if k.effects == ("zero",))
    assert replace(screened, beside=explanation("aside", "zeal")).effects == (
        "aside",
        "zeal",
        "zero",
    )


def test_what_leaves_far_more_than_the_best_is_given_up():
    screened = [leaving(1.0), leaving(2.0), leaving(30.0)]
    kept = list(promising(QUIET, screened, excess(1.0, FLOOR)))
    assert [screened.placed for screened in kept] == [screened.placed for screened in screened[:2]]


def test_a_fit_may_leave_more_than_the_best_look_yet_not_far_more():
    (kept,) = promising(QUIET, [leaving(1.0)], excess(1.0, FLOOR))
    assert 1.0 < kept.most_left < 10.0


GAINS, ZEROS = linear("gain", "abcd"), linear("zero", "abcd", SIGNALS[4:])
EVERYWHERE = linear("gain", ("arm", "a", "b", "c", "d"))
SIZES = st.sampled_from([-1.5, -0.4, 0.4, 2.0])


def screened_pairs(effects, truth, *, seed=0):
    simulator = Sums(effects)
    problem = problem_of(simulator, truth, seed)
    return {s.effects: s.placed for s in screen_pairs(problem, offer(problem), problem.floor**2)}


def found_in(placed):
    """Sizes by number, as the look has them."""
    terms = [block.terms[0] for block in placed.chosen]
    return dict(zip(terms, placed.coefficients, strict=True))


def planted(gains, zeros):
    return {amount("gain", p): v for p, v in gains.items()} | {
        amount("zero", p): v for p, v in zeros.items()
    }


@given(st.sampled_from("abcd"), st.sampled_from("abcd"), SIZES, SIZES, st.integers(0, 100))
@settings(max_examples=20, deadline=None)
def test_planted_pairs_are_found_with_both_places(one, other, gain, zero, seed):
    truth = planted({one: gain}, {other: zero})
    (placed,) = screened_pairs({**GAINS, **ZEROS}, truth, seed=seed).values()
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
    (placed,) = screened_pairs({**GAINS, **ZEROS}, truth).values()
    found = found_in(placed)
    assert found == pytest.approx({**dict.fromkeys(found, 0.0), **truth}, abs=0.05)


def test_what_is_everywhere_is_not_taken_apart():
    truth = planted({"arm": 0.5}, {"b": 1.0})
    (placed,) = screened_pairs({**EVERYWHERE, **ZEROS}, truth).values()
    assert found_in(placed) == pytest.approx(truth, abs=0.05)


def test_what_is_nearly_the_same_everywhere_is_not_taken_apart():
    """Place by place explains a little more, beside something else that nothing explains."""
    truth = planted({"a": 0.56, "b": 0.44, "c": 0.55, "d": 0.45}, {"b": 1.0})
    teeth = 0.5 * np.outer(np.sin(40.0 * TIME), [1.0, 1.0, 1.0])
    uneven = teeth + Sums({**EVERYWHERE, **ZEROS}).predict([truth])[0]
    (placed,) = screened_pairs({**EVERYWHERE, **ZEROS}, uneven).values()
    assert set(found_in(placed)) == {amount("gain", "arm"), amount("zero", "b")}


@pytest.mark.parametrize("gains", [{"c": 0.5}, {"a": 0.5, "d": -0.8}])
def test_what_is_in_some_places_is_not_everywhere(gains):
    truth = planted(gains, {"b": 1.0})
    (placed,) = screened_pairs({**EVERYWHERE, **ZEROS}, truth).values()
    assert found_in(placed) == pytest.approx(truth, abs=0.05)


def test_two_effects_are_seen_through_a_third_that_resembles_both():
    """Alone it explains more than either."""
    both = SIGNALS[1] + SIGNALS[6] + 0.5 * SIGNALS[3]
    library = {**linear("resembling", "a", [both]), **GAINS, **ZEROS}
    found = screened_pairs(library, planted({"b": 1.0}, {"c": 1.0}))
    assert set(found) == {("gain", "resembling"), ("resembling", "zero"), ("gain", "zero")}
    least = min(found, key=lambda names: found[names].mean_square)
    assert least == ("gain", "zero")


def test_without_two_effects_there_is_nothing():
    problem = problem_of(Sums(GAINS), {})
    assert screen_pairs(problem, {}, 1.0) == []
    assert screened_pairs(GAINS, planted({"a": 1.0}, {})) == {}
    nowhere = {c.effect: [()] for c in (*GAINS, *ZEROS)}
    assert screen_pairs(problem, nowhere, 1.0) == []
