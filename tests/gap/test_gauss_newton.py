"""Planted numbers are recovered, within their ranges, and with intervals that hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap_problem import (
    FLOOR,
    SIGNALS,
    TIME,
    TRIAL,
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
from numpy.testing import assert_allclose, assert_array_equal

from cablesense_gap.diagnosis.gauss_newton import refine, refit
from cablesense_gap.diagnosis.problem import (
    excess,
    from_scaled,
    is_logarithmic,
    prepare,
    prior_precision,
    to_scaled,
)
from cablesense_gap.simulator import Candidate, Term
from cablesense_sim.effects.effect import Parameter

READINGS = SIGNALS[0]
FOLD, USED = np.arange(12) % 4, np.ones(len(TRIAL), dtype=bool)


def test_tolerances_are_columns_of_one_standard_deviation():
    problem = prepare(Sums({}, scatter(0.2)), READINGS, TRIAL, FOLD, USED)
    assert problem.tolerance_terms == (
        Term("scatter", "a", "amount"), Term("scatter", "b", "amount"),
    )  # fmt: skip
    assert_allclose(problem.tolerance_std, 0.2)
    assert_allclose(problem.tolerance_columns[0], 0.2)
    assert_allclose(problem.tolerance_columns[1], 0.2 * np.outer(TIME, [1.0, 0.0, -1.0]))


def test_without_tolerances_there_are_no_columns():
    problem = prepare(Sums(linear("a", ["x"]), {}), READINGS, TRIAL, FOLD, USED)
    assert problem.tolerance_columns.shape == (0, *READINGS.shape)
    assert_array_equal(problem.nominal, 0.0)


def test_trials_are_counted_from_zero_whatever_their_numbers():
    problem = prepare(Sums({}), READINGS, 5 * TRIAL + 7, FOLD, USED)
    assert_array_equal(problem.trial, TRIAL)


def test_the_floor_is_that_of_the_sensors():
    assert prepare(Sums({}, floor=0.3), READINGS, TRIAL, FOLD, USED).floor == 0.3


SIZE, RATE = size("amount", typical=4.0, most=100.0), rate()
SHIFT = Parameter("shift", "1", -2.0, 2.0, 0.5, "a shape that may be zero", 0.0, "shape")


@given(st.sampled_from([SIZE, RATE, SHIFT]), st.floats(0.0, 1.0))
def test_there_and_back_is_the_same(parameter, share):
    value = parameter.low + share * (parameter.high - parameter.low)
    assert from_scaled(parameter, to_scaled(parameter, value)) == pytest.approx(value, abs=1e-12)


@given(st.sampled_from([SIZE, RATE, SHIFT]), st.floats(-50.0, 50.0))
def test_no_scaled_number_leaves_the_plausible_range(parameter, scaled):
    assert parameter.low <= from_scaled(parameter, scaled) <= parameter.high


def test_one_is_the_typical_size():
    assert to_scaled(SIZE, 4.0) == 1.0
    assert from_scaled(SIZE, -1.0) == -4.0


def test_only_what_is_never_zero_is_sought_by_its_logarithm():
    assert is_logarithmic(RATE)
    assert not is_logarithmic(SHIFT)
    assert not is_logarithmic(SIZE)
    assert to_scaled(RATE, np.e) == pytest.approx(1.0)


STIFFNESS = Parameter("change", "1", -0.8, 3.0, 0.2, "change", relative=True)


def test_a_quarter_is_as_far_from_nominal_as_four_times():
    assert to_scaled(STIFFNESS, 0.2) == pytest.approx(1.0)
    assert to_scaled(STIFFNESS, -0.75) == pytest.approx(-to_scaled(STIFFNESS, 3.0))
    assert from_scaled(STIFFNESS, to_scaled(STIFFNESS, -0.6)) == pytest.approx(-0.6)


@pytest.mark.parametrize("change", [-0.7, -0.59, 2.0])
def test_a_gross_change_of_a_stiffness_is_reached_from_none(change):
    candidate = Candidate("soft", ("x",), (STIFFNESS,))
    (term,) = candidate.terms("x")
    stretched = {candidate: lambda _, numbers: SIGNALS[0] / (1.0 + numbers["change"])}
    problem = problem_of(Sums(stretched), {term: change})
    found = refine(problem, {term: STIFFNESS}, [[0.0]])
    assert found.values[term] == pytest.approx(change, abs=1.5 * found.deviations[term])
    assert found.deviations[term] < 0.03 * (1.0 + change)


def test_a_size_is_expected_to_be_of_some_typical_ones():
    deviation = prior_precision(SIZE) ** -0.5
    assert 1.0 <= deviation <= 10.0
    assert prior_precision(RATE) > 0.0


PLACES = "b", "a", "b"
ONE = replace(
    explanation("gain"),
    values={Term("gain", place, f"x{k}"): 1.0 for k, place in enumerate(PLACES)},
    squares=np.array([4.0, 14.0]),
    count=np.array([4.0, 4.0]),
)


def test_the_held_out_error_is_over_all_numbers_of_all_trials():
    assert ONE.held_out_rmse == pytest.approx(1.5)
    longer = replace(ONE, count=np.array([2.0, 6.0]))
    assert longer.held_out_rmse == pytest.approx(1.5)


@given(st.floats(0.0, 100.0), st.floats(0.0, 100.0), st.floats(0.01, 10.0))
def test_more_left_is_more_excess(one, other, floor):
    less, more = sorted((one, other))
    assert 0.0 < excess(less, floor) <= excess(more, floor)


def test_nothing_is_told_apart_below_the_floor():
    assert excess(0.0, 0.3) == excess(0.09, 0.3) < 0.3


def test_far_above_the_floor_the_excess_is_what_is_left():
    assert excess(100.0, 0.1) == pytest.approx(10.0, rel=1e-3)


AMOUNT, RATE_TERM = Term("fading", "x", "amount"), Term("fading", "x", "rate")
GAIN = amount("gain", "a")


def fitted(problem, truth_or_starts, **options):
    """Fit the terms of some starts, which are given in plain numbers."""
    starts = truth_or_starts if isinstance(truth_or_starts, list) else [truth_or_starts]
    by_name = {(c.effect, p.name): p for c in problem.simulator.candidates for p in c.parameters}
    parameters = {term: by_name[term.effect, term.parameter] for term in starts[0]}
    scaled = [[to_scaled(parameters[t], v) for t, v in start.items()] for start in starts]
    return refine(problem, parameters, scaled, **options)


@given(st.floats(2.0, 10.0), st.floats(0.7, 9.0), st.booleans())
@settings(max_examples=25, deadline=None)
def test_a_nonlinear_effect_is_recovered_from_afar(amount_, rate, negative):
    truth = {AMOUNT: -amount_ if negative else amount_, RATE_TERM: rate}
    problem = problem_of(Sums(fading("fading", ["x"])), truth)
    found = fitted(problem, {AMOUNT: truth[AMOUNT] / 3.0, RATE_TERM: 3.0}, most_steps=20)
    for term, value in truth.items():
        assert found.values[term] == pytest.approx(value, rel=0.15)
    assert found.held_out_rmse == pytest.approx(FLOOR, rel=0.15)
    assert found.effects == ("fading",)


def test_of_several_starts_the_best_is_taken():
    """A tone is found from near its frequency alone."""
    time = np.arange(len(TRIAL)) / len(TRIAL)
    parameters = (size("amount"), Parameter("rate", "1", 1.0, 500.0, 50.0, "", 50.0, "shape"))

    def tone(_, numbers):
        wave = np.sin(numbers["rate"] * time)
        return numbers["amount"] * np.outer(wave, [1.0, 2.0, 3.0])

    simulator = Sums({Candidate("tone", ("x",), parameters): tone})
    size_, rate = (Term("tone", "x", name) for name in ("amount", "rate"))
    problem = problem_of(simulator, {size_: 1.0, rate: 120.0})
    starts = [{size_: 1.0, rate: r} for r in (10.0, 119.0, 300.0)]
    assert fitted(problem, starts).values[rate] == pytest.approx(120.0, rel=0.01)


def test_numbers_stay_in_their_plausible_range():
    simulator = Sums(linear("gain", ["a"], most=0.5))
    problem = problem_of(simulator, {GAIN: 2.0})
    simulator.asked.clear()
    assert fitted(problem, {GAIN: 0.1}).values[GAIN] == 0.5
    assert all(abs(variant[GAIN]) <= 0.5 for variant in simulator.asked)


def test_one_number_at_its_end_leaves_the_others_free():
    """Where the truth is beyond the range, the others are best for the end of the range."""
    mixed = SIGNALS[1] + 0.5 * SIGNALS[0]
    candidate = Candidate("two", ("x",), (size("low", most=0.5), size("high")))
    simulator = Sums({candidate: lambda _, n: n["low"] * SIGNALS[0] + n["high"] * mixed})
    low, high = (Term("two", "x", name) for name in ("low", "high"))
    problem = problem_of(simulator, 0.9 * SIGNALS[0] + 2.0 * mixed)
    found = fitted(problem, {low: 0.4, high: 0.1}, most_steps=20)
    best = (mixed * (problem.readings - 0.5 * SIGNALS[0])).sum() / (mixed**2).sum()
    assert found.values[low] == 0.5
    assert found.values[high] == pytest.approx(best, abs=0.02)
    assert abs(best - 2.0) > 0.05


def test_a_start_outside_the_range_begins_at_its_end():
    problem = problem_of(Sums(linear("gain", ["a"], most=3.0)), {GAIN: 1.0})
    assert fitted(problem, {GAIN: 50.0}).values[GAIN] == pytest.approx(1.0, abs=0.05)


def test_where_nothing_can_be_simulated_there_is_no_explanation():
    candidate = Candidate("broken", ("x",), (size("amount"),))
    simulator = Sums({candidate: lambda *_: np.nan * SIGNALS[0]})
    assert fitted(problem_of(simulator, 0.0 * SIGNALS[0]), {amount("broken", "x"): 1.0}) is None


def test_a_fit_that_comes_to_what_cannot_be_simulated_turns_back():
    """Beyond 1.2 there is no rest; the truth is 1."""
    candidate = Candidate("gain", ("a",), (size("amount"),))

    def change(_, numbers):
        beyond = np.where(numbers["amount"] > 1.2, np.nan, 1.0)
        return beyond * (numbers["amount"] + 0.5 * numbers["amount"] ** 3) * SIGNALS[0]

    problem = problem_of(Sums({candidate: change}), {GAIN: 1.0})
    assert fitted(problem, {GAIN: 0.2}, most_steps=20).values[GAIN] == pytest.approx(1.0, abs=0.05)


def test_without_effects_only_tolerances_are_fitted():
    problem = problem_of(
        Sums(linear("gain", ["a"]), scatter(0.5)), {Term("scatter", "a", "amount"): 0.8}
    )
    found = refine(problem, {}, [[]])
    assert found.effects == ()
    assert found.values == {}
    assert found.tolerances[Term("scatter", "a", "amount")] == pytest.approx(0.8, abs=0.05)
    assert found.tolerances[Term("scatter", "b", "amount")] == pytest.approx(0.0, abs=0.1)
    assert found.held_out_rmse == pytest.approx(FLOOR, rel=0.15)


def test_the_prediction_is_that_of_the_effects_with_the_tolerances():
    problem = problem_of(Sums(linear("gain", ["a", "b"])), {GAIN: 1.0})
    found = fitted(problem, {GAIN: 0.5, amount("gain", "b"): 0.5})
    expected = problem.simulator.predict([{**found.values, **found.tolerances}])[0]
    assert_allclose(found.prediction, expected, atol=1e-3)


def test_sensitivities_are_those_to_the_scaled_numbers():
    truth = {AMOUNT: 2.0, RATE_TERM: 3.0}
    problem = problem_of(Sums(fading("fading", ["x"])), truth)
    found = fitted(problem, truth)
    simulator = problem.simulator
    for column, term, step in zip(found.columns, found.values, (1e-5, 1e-5), strict=True):
        scale = (
            found.values[term] if term == RATE_TERM else 1.0
        )  # a rate is sought by its logarithm
        moved = {**found.values, term: found.values[term] + step * scale}
        expected = (simulator.predict([moved]) - simulator.predict([found.values]))[0] / step
        assert np.abs(column - expected).max() < 0.05 * np.abs(expected).max()


def test_held_out_trials_are_predicted_by_fits_that_have_not_seen_them():
    """In a linear mechanism the one step is the whole way."""
    problem = problem_of(Sums(linear("gain", ["a"]), scatter(0.5)), {GAIN: 1.0})
    found = fitted(problem, {GAIN: 1.0})
    strong = 1.0 / FLOOR**2
    for k in range(4):
        rows, others = problem.fold[problem.trial] == k, problem.fold[problem.trial] != k
        columns = np.concatenate([problem.tolerance_columns, SIGNALS[:1]])
        x, y = columns[:, others].reshape(3, -1), problem.readings[others].ravel()
        best = np.linalg.solve(strong * x @ x.T + np.diag([1, 1, 1 / 9]), strong * x @ y)
        expected = np.tensordot(best, columns[:, rows], axes=1)
        assert_allclose(found.held_out[rows], expected, atol=2e-3)
    left = ((problem.readings - found.held_out) ** 2).sum(-1)
    assert_allclose(found.squares, np.bincount(problem.trial, left))


COVERED = 0.85
"""Of intervals that should hold 95 %: few trials and a prior leave them somewhat narrow."""


def coverage(effects, truth, tolerances, seeds=100):
    """Share of the simulated recordings of workshops whose interval holds the truth, by term."""
    simulator = Sums(effects, tolerances)
    inside = []
    for seed in range(seeds):
        rng = np.random.default_rng([seed, 9])
        left = {
            term: rng.normal(0.0, parameter.typical)
            for candidate in simulator.tolerances
            for place in candidate.places
            for term, parameter in zip(candidate.terms(place), candidate.parameters, strict=True)
        }
        found = fitted(problem_of(simulator, {**truth, **left}, seed), truth)
        inside.append([abs(found.values[t] - v) <= found.deviations[t] for t, v in truth.items()])
    return np.mean(inside, axis=0)


@pytest.mark.slow
def test_intervals_hold_the_truth():
    truth = {GAIN: 0.3, amount("gain", "b"): -0.2}
    assert (coverage(linear("gain", ["a", "b"]), truth, scatter(0.05)) >= COVERED).all()


def test_intervals_of_a_nonlinear_effect_hold_the_truth():
    truth = {AMOUNT: 3.0, RATE_TERM: 9.0}
    assert (coverage(fading("fading", ["x"]), truth, scatter(0.05)) >= COVERED).all()


def test_intervals_allow_for_tolerances_that_look_alike():
    """An offset is only known up to the zero that a workshop leaves of the same sensor."""
    alike = linear("gain", ["a"], np.ones((1, *SIGNALS[0].shape)))
    assert (coverage(alike, {GAIN: 1.0}, scatter(0.3)) >= COVERED).all()


PROBLEM = problem_of(Sums(linear("gain", ["a", "b"])), {GAIN: 2.0})


def test_it_ends_at_the_planted_number():
    found = refit(PROBLEM, {GAIN: 1.0}, 4)
    assert found.values[GAIN] == pytest.approx(2.0, abs=0.02)
    assert found.held_out_rmse < 1.1 * FLOOR


def test_without_a_step_the_numbers_stay():
    assert refit(PROBLEM, {GAIN: 1.0}, 0).values == {GAIN: 1.0}


@pytest.mark.parametrize("truth", [0.0, -0.05])
def test_a_number_at_its_bound_is_known_as_far_as_the_readings_tell(truth: float) -> None:
    """Less than a hair's breadth from the bound is not known where the readings scatter."""
    term, column = amount("gain", "a"), SIGNALS[0]
    problem = problem_of(Sums(linear("gain", ["a"])), {term: truth})
    found = refine(problem, {term: Parameter("amount", "1", 0.0, 9.0, 1.0, "")}, [[0.5]])
    assert found is not None
    alone = 1.96 * FLOOR / np.sqrt((column**2).sum())
    assert found.values[term] < alone
    assert 0.5 * alone < found.deviations[term] < 3.0 * alone
