"""Planted numbers are recovered, within their ranges, and with intervals that hold."""

from __future__ import annotations

import numpy as np
import pytest
from gap_course import (
    FLOOR,
    SIGNALS,
    TRIAL,
    Sums,
    amount,
    course_of,
    fading,
    linear,
    scatter,
    size,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from cablesense_gap.diagnosis.gauss_newton import refine
from cablesense_gap.diagnosis.problem import to_scaled
from cablesense_gap.simulator import Candidate, Term
from cablesense_sim.effects.effect import Parameter

AMOUNT, RATE = Term("fading", "x", "amount"), Term("fading", "x", "rate")
GAIN = amount("gain", "a")


def fitted(course, truth_or_starts, **options):
    """Fit the terms of some starts, which are given in plain numbers."""
    starts = truth_or_starts if isinstance(truth_or_starts, list) else [truth_or_starts]
    by_name = {(c.effect, p.name): p for c in course.simulator.candidates for p in c.parameters}
    parameters = {term: by_name[term.effect, term.parameter] for term in starts[0]}
    scaled = [[to_scaled(parameters[t], v) for t, v in start.items()] for start in starts]
    return refine(course, parameters, scaled, **options)


@given(st.floats(2.0, 10.0), st.floats(0.7, 9.0), st.booleans())
@settings(max_examples=25, deadline=None)
def test_a_nonlinear_effect_is_recovered_from_afar(amount_, rate, negative):
    truth = {AMOUNT: -amount_ if negative else amount_, RATE: rate}
    course = course_of(Sums(fading("fading", ["x"])), truth)
    found = fitted(course, {AMOUNT: truth[AMOUNT] / 3.0, RATE: 3.0}, most_steps=20)
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
    course = course_of(simulator, {size_: 1.0, rate: 120.0})
    starts = [{size_: 1.0, rate: r} for r in (10.0, 119.0, 300.0)]
    assert fitted(course, starts).values[rate] == pytest.approx(120.0, rel=0.01)


def test_numbers_stay_in_their_plausible_range():
    simulator = Sums(linear("gain", ["a"], most=0.5))
    course = course_of(simulator, {GAIN: 2.0})
    simulator.asked.clear()
    assert fitted(course, {GAIN: 0.1}).values[GAIN] == 0.5
    assert all(abs(variant[GAIN]) <= 0.5 for variant in simulator.asked)


def test_one_number_at_its_end_leaves_the_others_free():
    """Where the truth is beyond the range, the others are best for the end of the range."""
    mixed = SIGNALS[1] + 0.5 * SIGNALS[0]
    candidate = Candidate("two", ("x",), (size("low", most=0.5), size("high")))
    simulator = Sums({candidate: lambda _, n: n["low"] * SIGNALS[0] + n["high"] * mixed})
    low, high = (Term("two", "x", name) for name in ("low", "high"))
    course = course_of(simulator, 0.9 * SIGNALS[0] + 2.0 * mixed)
    found = fitted(course, {low: 0.4, high: 0.1}, most_steps=20)
    best = (mixed * (course.readings - 0.5 * SIGNALS[0])).sum() / (mixed**2).sum()
    assert found.values[low] == 0.5
    assert found.values[high] == pytest.approx(best, abs=0.02)
    assert abs(best - 2.0) > 0.05


def test_a_start_outside_the_range_begins_at_its_end():
    course = course_of(Sums(linear("gain", ["a"], most=3.0)), {GAIN: 1.0})
    assert fitted(course, {GAIN: 50.0}).values[GAIN] == pytest.approx(1.0, abs=0.05)


def test_where_nothing_can_be_simulated_there_is_no_hypothesis():
    candidate = Candidate("broken", ("x",), (size("amount"),))
    simulator = Sums({candidate: lambda *_: np.nan * SIGNALS[0]})
    assert fitted(course_of(simulator, 0.0 * SIGNALS[0]), {amount("broken", "x"): 1.0}) is None


def test_a_fit_that_comes_to_what_cannot_be_simulated_turns_back():
    """Beyond 1.2 there is no rest; the truth is 1."""
    candidate = Candidate("gain", ("a",), (size("amount"),))

    def change(_, numbers):
        beyond = np.where(numbers["amount"] > 1.2, np.nan, 1.0)
        return beyond * (numbers["amount"] + 0.5 * numbers["amount"] ** 3) * SIGNALS[0]

    course = course_of(Sums({candidate: change}), {GAIN: 1.0})
    assert fitted(course, {GAIN: 0.2}, most_steps=20).values[GAIN] == pytest.approx(1.0, abs=0.05)


def test_without_effects_only_tolerances_are_fitted():
    course = course_of(
        Sums(linear("gain", ["a"]), scatter(0.5)), {Term("scatter", "a", "amount"): 0.8}
    )
    found = refine(course, {}, [[]])
    assert found.effects == ()
    assert found.values == {}
    assert found.tolerances[Term("scatter", "a", "amount")] == pytest.approx(0.8, abs=0.05)
    assert found.tolerances[Term("scatter", "b", "amount")] == pytest.approx(0.0, abs=0.1)
    assert found.held_out_rmse == pytest.approx(FLOOR, rel=0.15)


def test_the_prediction_is_that_of_the_effects_with_the_tolerances():
    course = course_of(Sums(linear("gain", ["a", "b"])), {GAIN: 1.0})
    found = fitted(course, {GAIN: 0.5, amount("gain", "b"): 0.5})
    expected = course.simulator.predict([{**found.values, **found.tolerances}])[0]
    assert_allclose(found.prediction, expected, atol=1e-3)


def test_sensitivities_are_those_to_the_scaled_numbers():
    truth = {AMOUNT: 2.0, RATE: 3.0}
    course = course_of(Sums(fading("fading", ["x"])), truth)
    found = fitted(course, truth)
    simulator = course.simulator
    for column, term, step in zip(found.columns, found.values, (1e-5, 1e-5), strict=True):
        scale = found.values[term] if term == RATE else 1.0  # a rate is sought by its logarithm
        moved = {**found.values, term: found.values[term] + step * scale}
        expected = (simulator.predict([moved]) - simulator.predict([found.values]))[0] / step
        assert np.abs(column - expected).max() < 0.05 * np.abs(expected).max()


def test_held_out_trials_are_predicted_by_fits_that_have_not_seen_them():
    """In a linear mechanism the one step is the whole way."""
    course = course_of(Sums(linear("gain", ["a"]), scatter(0.5)), {GAIN: 1.0})
    found = fitted(course, {GAIN: 1.0})
    strong = 1.0 / FLOOR**2
    for k in range(4):
        rows, others = course.fold[course.trial] == k, course.fold[course.trial] != k
        columns = np.concatenate([course.tolerance_columns, SIGNALS[:1]])
        x, y = columns[:, others].reshape(3, -1), course.readings[others].ravel()
        best = np.linalg.solve(strong * x @ x.T + np.diag([1, 1, 1 / 9]), strong * x @ y)
        expected = np.tensordot(best, columns[:, rows], axes=1)
        assert_allclose(found.held_out[rows], expected, atol=2e-3)
    left = ((course.readings - found.held_out) ** 2).sum(-1)
    assert_allclose(found.squares, np.bincount(course.trial, left))


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
        found = fitted(course_of(simulator, {**truth, **left}, seed), truth)
        inside.append([abs(found.values[t] - v) <= found.deviations[t] for t, v in truth.items()])
    return np.mean(inside, axis=0)


def test_intervals_hold_the_truth():
    truth = {GAIN: 0.3, amount("gain", "b"): -0.2}
    assert (coverage(linear("gain", ["a", "b"]), truth, scatter(0.05)) >= COVERED).all()


def test_intervals_of_a_nonlinear_effect_hold_the_truth():
    truth = {AMOUNT: 3.0, RATE: 9.0}
    assert (coverage(fading("fading", ["x"]), truth, scatter(0.05)) >= COVERED).all()


def test_intervals_allow_for_tolerances_that_look_alike():
    """An offset is only known up to the zero that a workshop leaves of the same sensor."""
    alike = linear("gain", ["a"], np.ones((1, *SIGNALS[0].shape)))
    assert (coverage(alike, {GAIN: 1.0}, scatter(0.3)) >= COVERED).all()
