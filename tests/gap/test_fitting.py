"""Fits with the simulator: columns, starts, planted numbers, their ranges and intervals."""

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
from numpy.testing import assert_allclose

from cablesense_gap.diagnosis.fitting import (
    final_refinement,
    fit,
    refine,
    with_fitted_tolerances,
)
from cablesense_gap.diagnosis.problem import (
    from_scaled,
    to_scaled,
)
from cablesense_gap.diagnosis.selection import Selection, linear_effects
from cablesense_gap.simulator import Candidate, Term
from cablesense_sim.effects.effect import Parameter

GAIN, OTHER_GAIN = amount("gain", "a"), amount("gain", "b")
AMOUNT, RATE = amount("fading", "x"), Term("fading", "x", "rate")
PLAIN = linear("gain", "abc")
((FADING, FADES),) = fading("fading", "xy", history_dependent=True).items()
TRIED = replace(FADING, parameters=(size("amount"), replace(rate(), trials=(1.0, 5.0, 25.0))))


SIZE = size("amount", typical=4.0, most=100.0)
SHIFT = Parameter("shift", "1", -2.0, 2.0, 0.5, "a shape that may be zero", 0.0, "shape")
STIFFNESS = Parameter("change", "1", -0.8, 3.0, 0.2, "change", relative=True)


@pytest.mark.parametrize("parameter", [SIZE, rate(), SHIFT, STIFFNESS], ids=lambda p: p.name)
def test_scaled_values_return_and_stay_in_the_plausible_range(parameter):
    for value in np.linspace(parameter.low, parameter.high, 7):
        assert from_scaled(parameter, to_scaled(parameter, value)) == pytest.approx(value)
    for scaled in (-50.0, 0.3, 50.0):
        assert parameter.low <= from_scaled(parameter, scaled) <= parameter.high


def linearised(effects):
    simulator = Sums(effects)
    return linear_effects(problem_of(simulator, {}), simulator.candidates[0])


def test_a_linear_effect_has_the_change_of_its_typical_size_as_column_in_each_place():
    candidate = Candidate("gain", ("x", "broken", "z"), (size("amount", typical=0.2),))
    by_place = {"x": SIGNALS[0], "broken": np.nan * SIGNALS[1], "z": SIGNALS[2]}
    found = linearised({candidate: lambda place, n: n["amount"] * by_place[place]})
    assert [effect.place for effect in found] == ["x", "z"]  # the other cannot be simulated
    for effect in found:
        assert_allclose(effect.columns, 0.2 * by_place[effect.place][None], atol=1e-12)
        assert effect.terms == (Term("gain", effect.place, "amount"),)
        assert_allclose(effect.start, 0.0)


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
    found = fitted(problem, {AMOUNT: truth[AMOUNT] / 3.0, RATE: 3.0}, most_steps=20)
    assert found.values == pytest.approx(truth, rel=0.15)
    assert found.held_out_rmse == pytest.approx(FLOOR, rel=0.15)
    assert found.effects == ("fading",)


@pytest.mark.parametrize("change", [-0.7, -0.59, 2.0])
def test_a_gross_change_of_a_stiffness_is_reached_from_none(change):
    candidate = Candidate("soft", ("x",), (STIFFNESS,))
    (term,) = candidate.terms("x")
    stretched = {candidate: lambda _, numbers: SIGNALS[0] / (1.0 + numbers["change"])}
    found = fitted(problem_of(Sums(stretched), {term: change}), {term: 0.0})
    assert found.values[term] == pytest.approx(change, abs=1.5 * found.deviations[term])
    assert found.deviations[term] < 0.03 * (1.0 + change)


def tone_of(frequency, **options):
    """A tone is found from near its frequency alone."""
    candidate = Candidate("tone", ("x",), (size("amount", 10.0), frequency), **options)

    def tone(_, numbers):
        return numbers["amount"] * np.outer(np.sin(numbers["rate"] * TIME), [1.0, 2.0, 3.0])

    return {candidate: tone}, *candidate.terms("x")


def test_one_number_at_its_end_leaves_the_others_free():
    """If the truth is beyond the range, the others are best for the end of the range."""
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


def test_a_fit_turns_back_from_what_cannot_be_simulated():
    """Beyond `limit` there is no equilibrium; the truth is 1."""
    candidate = Candidate("gain", ("a",), (size("amount"),))

    def problem(limit):
        def change(_, numbers):
            beyond = np.where(numbers["amount"] > limit, np.nan, 1.0)
            return beyond * (numbers["amount"] + 0.5 * numbers["amount"] ** 3) * SIGNALS[0]

        return problem_of(Sums({candidate: change}), 1.5 * SIGNALS[0])

    found = fitted(problem(1.2), {GAIN: 0.2}, most_steps=20)
    assert found.values[GAIN] == pytest.approx(1.0, abs=0.05)
    assert fitted(problem(-99.0), {GAIN: 1.0}) is None


def test_prediction_and_sensitivities_are_those_of_the_simulator():
    truth = {AMOUNT: 2.0, RATE: 3.0}
    problem = problem_of(Sums(fading("fading", ["x"])), truth)
    found, simulator = fitted(problem, truth), problem.simulator
    expected = simulator.predict([{**found.values, **found.tolerances}])[0]
    assert_allclose(found.prediction, expected, atol=1e-3)
    for column, term in zip(found.columns, found.values, strict=True):
        step = 1e-5 * (found.values[term] if term == RATE else 1.0)  # a rate by its logarithm
        moved = {**found.values, term: found.values[term] + step}
        change = (simulator.predict([moved]) - simulator.predict([found.values]))[0] / 1e-5
        assert np.abs(column - change).max() < 0.05 * np.abs(change).max()


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
    assert found.held_out_rmse == pytest.approx(np.sqrt(left.sum() / problem.readings.size))


ALIKE = linear("gain", ["a"], np.ones((1, *SIGNALS[0].shape)))


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
        left = {amount("scatter", place): rng.normal(0.0, std) for place in "ab"}
        found = fitted(problem_of(simulator, {**truth, **left}, seed), truth)
        inside.append([abs(found.values[t] - v) <= found.deviations[t] for t, v in truth.items()])
    assert (np.mean(inside, axis=0) >= 0.85).all()


def proposed(library, truth, about=None):
    problem = problem_of(Sums(library), truth)
    about = about or refine(problem, {}, [[]])
    offered = [e for c in problem.simulator.candidates for e in linear_effects(problem, c)]
    others = [e for e in offered if e.effect not in about.effects]
    return problem, Selection(problem, about, others).additions()


def added(library, truth, about=None):
    problem, proposals = proposed(library, truth, about)
    return min(fit(problem, proposals[0]), key=problem.judged)


@pytest.mark.parametrize(
    "truth",
    [
        {OTHER_GAIN: 0.3},
        {OTHER_GAIN: -20.0},
        {OTHER_GAIN: 1.0, amount("gain", "c"): -0.6},
    ],
    ids=["small", "large", "two places"],
)
def test_a_plain_effect_has_its_planted_numbers(truth):
    found = added(PLAIN, truth)
    assert found.values == pytest.approx(truth, abs=0.02)
    assert found.held_out_rmse == pytest.approx(FLOOR, rel=0.15)


@pytest.mark.parametrize("effect", [FADING, TRIED], ids=["one shape", "several shapes"])
@pytest.mark.parametrize("planted", [0.7, 6.0, 20.0])
def test_history_dependent_effects_are_found_from_another_shape(effect, planted):
    """Their columns are taken at a rate of two."""
    truth = {AMOUNT: 6.0, RATE: planted}
    assert added({effect: FADES}, truth).values == pytest.approx(truth, rel=0.15)


def test_a_fit_starts_at_the_shape_that_explains_most():
    frequency = replace(rate((3.0,)), high=200.0, trials=(3.0, 12.0, 50.0))
    effect, size_, rate_ = tone_of(frequency, history_dependent=True)
    found = added(effect, {size_: 2.0, rate_: 48.0})
    assert found.values[rate_] == pytest.approx(48.0, rel=0.05)


def test_an_explanation_and_its_additions_are_fitted_together():
    """The first alone was wrong, because the second was missing."""
    resembling = linear("gain", "ab", [SIGNALS[0], SIGNALS[1] + 0.7 * SIGNALS[6]])
    library = {**resembling, TRIED: FADES}
    truth = {AMOUNT: 5.0, RATE: 5.0, OTHER_GAIN: 1.0}
    problem, proposals = proposed(library, truth)
    alone = next(p for p in proposals if p.effects == ("fading",))
    first = min(fit(problem, alone), key=problem.judged)
    assert first.values[RATE] < 4.0
    assert added(library, truth, first).values == pytest.approx(truth, rel=0.1)


OFF = amount("scatter", "b")


class Coupled(Sums):
    """The change by a tolerance grows with the effect; with both, it may fail."""

    fails = False

    def _one(self, variant):
        gain, off = variant.get(GAIN, 0.0), variant.get(OFF, 0.0)
        both = np.nan if self.fails and GAIN in variant and OFF in variant else gain * off
        return super()._one(variant) + 40.0 * np.asarray(both) * SIGNALS[3]


def test_tolerances_are_taken_as_they_act_next_to_the_effect():
    simulator = Coupled(linear("gain", ["a"]), scatter())
    problem = problem_of(simulator, {GAIN: 2.0, OFF: 0.05})
    rough = fitted(problem, {GAIN: 2.0})
    refined, (columns, _) = final_refinement(problem, rough)
    assert not np.allclose(columns, problem.tolerance_columns)
    assert rough.held_out_rmse > 10.0 * FLOOR
    assert refined.held_out_rmse < 1.1 * FLOOR
    assert refined.values[GAIN] == pytest.approx(2.0, abs=0.02)
    assert refined.tolerances[OFF] == pytest.approx(0.05, rel=0.5)
    none = refine(problem, {}, [[]])
    assert final_refinement(problem, none)[0] is none
    simulator.fails = True
    assert problem.cost_of(final_refinement(problem, rough)[0]) <= problem.cost_of(rough)


class Curved(Sums):
    """The change by a tolerance grows with its square too, and with the effect."""

    def _one(self, variant):
        gain, off = variant.get(GAIN, 0.0), variant.get(OFF, 0.0)
        return super()._one(variant) + off * (gain * 20.0 + off * 900.0) * SIGNALS[3]


def test_tolerances_are_taken_as_they_act_where_they_are():
    simulator = Curved(linear("gain", ["a"]), scatter())
    linear_about_zero = problem_of(simulator, {GAIN: 0.0, OFF: 0.15})
    problem = with_fitted_tolerances(linear_about_zero)
    before, after = (refine(each, {}, [[]]) for each in (linear_about_zero, problem))
    assert before.held_out_rmse > 3.0 * FLOOR
    assert after.held_out_rmse < 1.1 * FLOOR
    assert after.tolerances[OFF] == pytest.approx(0.15, rel=0.1)
    both = with_fitted_tolerances(problem_of(simulator, {GAIN: 2.0, OFF: 0.15}))
    refined = final_refinement(both, fitted(both, {GAIN: 2.0}))[0]
    assert refined.held_out_rmse < 1.1 * FLOOR
    assert refined.values[GAIN] == pytest.approx(2.0, abs=0.05)
    straight = problem_of(Sums(linear("gain", ["a"]), scatter()), {OFF: 0.15})
    assert with_fitted_tolerances(straight) is straight
