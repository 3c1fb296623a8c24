"""Fits with the simulator: columns, starts, planted numbers, their ranges and intervals."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from cablesense_gap.diagnosis.fitting import joint_step, refine
from cablesense_gap.diagnosis.nuisance import final_refinement, with_fitted_nuisance
from cablesense_gap.diagnosis.problem import from_scaled, to_scaled
from cablesense_gap.diagnosis.selection import linear_effects
from cablesense_gap.simulator import Candidate, Term
from cablesense_sim.effects.effect import Parameter
from tests.helpers.gap_problem import (
    FLOOR,
    SIGNALS,
    Sums,
    amount,
    fading,
    linear,
    problem_of,
    rate,
    scatter,
    size,
)

GAIN = amount("gain", "a")
OTHER_GAIN = amount("gain", "b")
AMOUNT = amount("fading", "x")
RATE = Term("fading", "x", "rate")


SIZE = size("amount", typical=4.0, most=100.0)
SHIFT = Parameter("shift", "1", -2.0, 2.0, 0.5, "a shape that may be zero", 0.0, "shape")
STIFFNESS = Parameter("change", "1", -0.8, 3.0, 0.2, "change", relative=True)


@pytest.mark.parametrize("parameter", [SIZE, rate(), SHIFT, STIFFNESS], ids=lambda p: p.name)
def test_scaled_values_return_and_stay_in_the_plausible_range(parameter):
    for value in np.linspace(parameter.low, parameter.high, 7):
        assert from_scaled(parameter, to_scaled(parameter, value)) == pytest.approx(value)
    for scaled in (-50.0, 0.3, 50.0):
        assert parameter.low <= from_scaled(parameter, scaled) <= parameter.high


def fitted(problem, *starts, **options):
    """Fit the terms of some starts, which are given in plain numbers."""
    by_name = {(c.effect, p.name): p for c in problem.simulator.candidates for p in c.parameters}
    parameters = {term: by_name[term.effect, term.parameter] for term in starts[0]}
    scaled = [[to_scaled(parameters[t], v) for t, v in start.items()] for start in starts]
    return refine(problem, parameters, scaled, **options)


@pytest.mark.parametrize("truth", [(2.0, 0.7), (-6.0, 3.0), (9.0, 9.0)])
def test_a_nonlinear_effect_is_recovered_from_afar(truth):
    truth = dict(zip((AMOUNT, RATE), truth, strict=True))
    problem = problem_of(Sums(fading("fading", ["x"])), truth)
    fit = fitted(problem, {AMOUNT: truth[AMOUNT] / 3.0, RATE: 3.0}, most_steps=20)
    assert fit.values == pytest.approx(truth, rel=0.15)
    assert fit.held_out_rmse == pytest.approx(FLOOR, rel=0.15)
    assert fit.effects == ("fading",)


@pytest.mark.parametrize("change", [-0.7, -0.59, 2.0])
def test_a_gross_change_of_a_stiffness_is_reached_from_none(change):
    candidate = Candidate("soft", ("x",), (STIFFNESS,))
    (term,) = candidate.terms("x")
    stretched = {candidate: lambda _, numbers: SIGNALS[0] / (1.0 + numbers["change"])}
    fit = fitted(problem_of(Sums(stretched), {term: change}), {term: 0.0})
    assert fit.values[term] == pytest.approx(change, abs=1.5 * fit.deviations[term])
    assert fit.deviations[term] < 0.03 * (1.0 + change)


def test_one_number_at_its_end_leaves_the_others_free():
    """If the truth is beyond the range, the others are best for the end of the range."""
    mixed = SIGNALS[1] + 0.5 * SIGNALS[0]
    candidate = Candidate("two", ("x",), (size("low", most=0.5), size("high")))
    simulator = Sums({candidate: lambda _, n: n["low"] * SIGNALS[0] + n["high"] * mixed})
    low, high = (Term("two", "x", name) for name in ("low", "high"))
    problem = problem_of(simulator, 0.9 * SIGNALS[0] + 2.0 * mixed)
    fit = fitted(problem, {low: 0.4, high: 0.1}, most_steps=20)
    best = (mixed * (problem.readings - 0.5 * SIGNALS[0])).sum() / (mixed**2).sum()
    assert fit.values[low] == 0.5
    assert fit.values[high] == pytest.approx(best, abs=0.02)
    assert abs(best - 2.0) > 0.05


def test_a_fit_turns_back_from_what_cannot_be_simulated():
    """Beyond `limit` there is no equilibrium; the truth is 1."""
    candidate = Candidate("gain", ("a",), (size("amount"),))

    def problem(limit):
        def change(_, numbers):
            beyond = np.where(numbers["amount"] > limit, np.nan, 1.0)
            return beyond * (numbers["amount"] + 0.5 * numbers["amount"] ** 3) * SIGNALS[0]

        return problem_of(Sums({candidate: change}), 1.5 * SIGNALS[0])

    fit = fitted(problem(1.2), {GAIN: 0.2}, most_steps=20)
    assert fit.values[GAIN] == pytest.approx(1.0, abs=0.05)
    assert fitted(problem(-99.0), {GAIN: 1.0}) is None


def test_held_out_trials_are_predicted_by_fits_that_have_not_seen_them():
    """In a linear mechanism the one step is the whole way. Tolerances have seen all trials."""
    problem = problem_of(Sums(linear("gain", ["a"]), scatter(0.5)), {GAIN: 1.0})
    fit = fitted(problem, {GAIN: 1.0})
    strong = 1.0 / FLOOR**2
    for k in range(4):
        rows = problem.fold[problem.trial] == k
        others = problem.fold[problem.trial] != k
        columns = np.concatenate([problem.nuisance_columns, SIGNALS[:1]])
        x = columns[:, others].reshape(3, -1)
        y = problem.readings[others].ravel()
        best = np.linalg.solve(strong * x @ x.T + np.diag([1, 1, 1 / 9]), strong * x @ y)
        t = problem.nuisance_columns.reshape(2, -1)
        beside = (problem.readings - best[2] * columns[2]).ravel()
        best[:2] = np.linalg.solve(strong * t @ t.T + np.eye(2), strong * t @ beside)
        expected = np.tensordot(best, columns[:, rows], axes=1)
        assert_allclose(fit.held_out[rows], expected, atol=2e-3)
    squares_left = ((problem.readings - fit.held_out) ** 2).sum(-1)
    assert_allclose(fit.squares, np.bincount(problem.trial, squares_left))
    assert fit.held_out_rmse == pytest.approx(np.sqrt(squares_left.sum() / problem.readings.size))


ALIKE = linear("gain", ["a"], np.ones((1, *SIGNALS[0].shape)))


def test_an_effect_takes_over_from_the_tolerance_that_is_the_same_number():
    """Two priors share one number by their variances, here 9 and 0.05²: it is all the effect's."""
    problem = problem_of(Sums(ALIKE, scatter(0.05), floor=1e-3), {GAIN: 0.2})
    fit = fitted(problem, {GAIN: 0.0})
    (tolerance,) = (v for t, v in fit.nuisance.items() if t.place == "a")
    assert fit.values[GAIN] == pytest.approx(0.2, abs=0.02)
    assert abs(tolerance) < 0.02


@pytest.mark.parametrize(
    ("effects", "truth", "std"),
    [
        (linear("gain", ["a", "b"]), {GAIN: 0.3, OTHER_GAIN: -0.2}, 0.05),
        (fading("fading", ["x"]), {AMOUNT: 3.0, RATE: 9.0}, 0.05),
        (ALIKE, {GAIN: 1.0}, 0.3),
    ],
    ids=["linear", "nonlinear", "like a tolerance"],
)
def test_intervals_hold_the_truth(effects, truth, std):
    """In 95 % of workshops; few trials and a prior leave the intervals somewhat narrow."""
    simulator = Sums(effects, scatter(std))
    inside = []
    for seed in range(30):
        rng = np.random.default_rng([seed, 9])
        nuisance = {amount("scatter", place): rng.normal(0.0, std) for place in "ab"}
        fit = fitted(problem_of(simulator, {**truth, **nuisance}, seed), truth)
        inside.append([abs(fit.values[t] - v) <= fit.deviations[t] for t, v in truth.items()])
    assert (np.mean(inside, axis=0) >= 0.85).all()


OFF = amount("scatter", "b")


class Curved(Sums):
    """The change by a tolerance grows with its square too, and with the effect."""

    def _one(self, variant):
        gain = variant.get(GAIN, 0.0)
        off = variant.get(OFF, 0.0)
        return super()._one(variant) + off * (gain * 20.0 + off * 900.0) * SIGNALS[3]


def test_tolerances_are_taken_as_they_act_where_they_are():
    simulator = Curved(linear("gain", ["a"]), scatter())
    linear_about_zero = problem_of(simulator, {GAIN: 0.0, OFF: 0.1})
    problem = with_fitted_nuisance(linear_about_zero)
    before, after = (refine(each, {}, [[]]) for each in (linear_about_zero, problem))
    assert before.nuisance[OFF] > 0.15
    assert after.held_out_rmse < 1.05 * FLOOR
    assert after.nuisance[OFF] == pytest.approx(0.1, rel=0.1)
    both = with_fitted_nuisance(problem_of(simulator, {GAIN: 2.0, OFF: 0.1}))
    refined = final_refinement(both, fitted(both, {GAIN: 2.0}))[0]
    assert refined.held_out_rmse < 1.1 * FLOOR
    assert refined.values[GAIN] == pytest.approx(2.0, abs=0.05)
    straight = problem_of(Sums(linear("gain", ["a"]), scatter()), {OFF: 0.1})
    kept = with_fitted_nuisance(straight).nuisance_columns
    assert kept is straight.nuisance_columns


class Same(Sums):
    """The effect and one of the tolerances are the same number."""

    def _one(self, variant):
        one = variant.get(GAIN, 0.0) + variant.get(amount("scatter", "a"), 0.0)
        off = variant.get(OFF, 0.0)
        return one * (SIGNALS[0] + 40.0 * off * SIGNALS[3] + 3.0 * one * SIGNALS[1])


def test_an_effect_that_a_tolerance_imitates_has_the_same_column():
    problem = problem_of(Same(linear("gain", ["a"]), scatter()), {GAIN: 2.0, OFF: 0.15})
    refined, about = final_refinement(problem, fitted(problem, {GAIN: 2.0}))
    assert refined.nuisance[OFF] == pytest.approx(0.15, rel=0.1)
    assert_allclose(refined.columns[0], about.nuisance_columns[0] / 0.05, atol=0.1)


def test_a_joint_step_of_effect_and_tolerance_leads_to_the_best_of_both():
    problem = problem_of(Sums(ALIKE, scatter(0.05), floor=1e-3), {GAIN: 0.2})
    stepped = joint_step(problem, fitted(problem, {GAIN: 0.5}, most_steps=0))
    best = fitted(problem, {GAIN: 0.5}, most_steps=20)
    assert stepped.values == pytest.approx(best.values, abs=1e-3)
    assert stepped.nuisance == pytest.approx(best.nuisance, abs=1e-3)
    assert joint_step(problem, best) is None


def test_effects_act_beside_the_tolerances_that_fit_best():
    """As the tolerance that is the same number acts there, and not as on the nominal mechanism."""
    simulator = Same(linear("gain", ["a"]), scatter())
    nominal = problem_of(simulator, {GAIN: 0.12})
    problem = with_fitted_nuisance(nominal)
    without_effects = refine(problem, {}, [[]])
    assert without_effects.held_out_rmse < 1.1 * FLOOR
    (effect,) = linear_effects(problem, simulator.candidates[0], without_effects)
    as_tolerance = problem.nuisance_columns[0] / 0.05
    assert_allclose(effect.columns[0], as_tolerance, atol=0.12 * np.abs(as_tolerance).max())
    assert_array_equal(problem.predict([{}])[0], nominal.nominal)


@pytest.mark.parametrize("imitating", [0.05, 0.4])
def test_a_tolerance_that_imitates_an_effect_leaves_others_where_they_are(imitating):
    truth = {OFF: 0.08, amount("scatter", "a"): imitating}
    problem = with_fitted_nuisance(problem_of(Curved({}, scatter()), truth))
    k = problem.nuisance_terms.index(OFF)
    straight = problem_of(Sums({}, scatter()), {}).nuisance_columns[k]
    bent = problem.nuisance_columns[k] - straight
    assert_allclose(bent, 0.05 * 1800.0 * 0.08 * SIGNALS[3], rtol=0.2)
