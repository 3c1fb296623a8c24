"""Fits with the simulator: columns, starts, planted numbers, their ranges and intervals."""

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
    fading,
    linear,
    problem_of,
    rate,
    scatter,
    size,
)
from numpy.testing import assert_allclose, assert_array_equal

from cablesense_gap.diagnosis.columns import linear_effects
from cablesense_gap.diagnosis.fitting import fit
from cablesense_gap.diagnosis.gauss_newton import final_refinement, refine, refit
from cablesense_gap.diagnosis.problem import (
    excess,
    from_scaled,
    prepare,
    prior_precision,
    to_scaled,
)
from cablesense_gap.diagnosis.selection import Selection
from cablesense_gap.simulator import Candidate, Term
from cablesense_sim.effects.effect import Parameter

GAIN, OTHER_GAIN = amount("gain", "a"), amount("gain", "b")
AMOUNT, RATE = amount("fading", "x"), Term("fading", "x", "rate")
PLAIN = linear("gain", "abc")
((FADING, FADES),) = fading("fading", "xy", history_dependent=True).items()
TRIED = replace(FADING, parameters=(size("amount"), replace(rate(), trials=(1.0, 5.0, 25.0))))


def test_the_problem_has_columns_of_tolerances_and_trials_from_zero():
    used = np.ones(len(TRIAL), dtype=bool)
    problem = prepare(Sums({}, scatter(0.2)), SIGNALS[0], 5 * TRIAL + 7, np.arange(12) % 4, used)
    assert problem.tolerance_terms == (amount("scatter", "a"), amount("scatter", "b"))
    assert_allclose(problem.tolerance_std, 0.2)
    assert_allclose(problem.tolerance_columns[0], 0.2)
    assert_allclose(problem.tolerance_columns[1], 0.2 * np.outer(TIME, [1.0, 0.0, -1.0]))
    assert_array_equal(problem.trial, TRIAL)


SIZE = size("amount", typical=4.0, most=100.0)
SHIFT = Parameter("shift", "1", -2.0, 2.0, 0.5, "a shape that may be zero", 0.0, "shape")
STIFFNESS = Parameter("change", "1", -0.8, 3.0, 0.2, "change", relative=True)


@pytest.mark.parametrize("parameter", [SIZE, rate(), SHIFT, STIFFNESS], ids=lambda p: p.name)
def test_scaled_values_return_and_stay_in_the_plausible_range(parameter):
    for value in np.linspace(parameter.low, parameter.high, 7):
        assert from_scaled(parameter, to_scaled(parameter, value)) == pytest.approx(value)
    for scaled in (-50.0, 0.3, 50.0):
        assert parameter.low <= from_scaled(parameter, scaled) <= parameter.high


def test_a_scaled_value_is_in_typical_sizes_or_a_logarithm():
    assert (to_scaled(SIZE, 4.0), from_scaled(SIZE, -1.0)) == (1.0, -4.0)
    assert to_scaled(rate(), np.e) == pytest.approx(1.0)
    assert to_scaled(STIFFNESS, 0.2) == pytest.approx(1.0)
    # a quarter is as far from nominal as four times
    assert to_scaled(STIFFNESS, -0.75) == pytest.approx(-to_scaled(STIFFNESS, 3.0))


def test_the_excess_grows_with_the_residual_and_is_not_resolved_below_the_floor():
    sizes = [excess(mean_square, 0.3) for mean_square in (0.0, 0.09, 0.1, 1.0, 100.0)]
    assert sizes[0] == sizes[1] < 0.3
    assert sizes == sorted(sizes)
    assert sizes[-1] == pytest.approx(10.0, rel=1e-2)


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


@pytest.mark.parametrize("history_dependent", [False, True])
def test_every_starting_shape_has_its_own_columns(history_dependent):
    parameters = size("amount"), rate((1.0, 8.0))
    candidate = Candidate("fading", ("x", "y"), parameters, history_dependent)
    found = linearised({candidate: FADES})
    expected = [(rate, signal) for rate in (1.0, 8.0) for signal in SIGNALS[6:]]
    for effect, (rate_, signal) in zip(found, expected, strict=True):
        assert_allclose(effect.columns, [np.exp(-rate_ * TIME)[:, None] * signal], atol=1e-12)
        assert_allclose(effect.start, [0.0, np.log(rate_)])


def test_two_sizes_and_a_shape_that_may_be_zero_have_a_column_each():
    candidate = Candidate("moved", ("x",), (size("amount", 2.0), size("other", 0.3), SHIFT))

    def change(_, n):
        return n["amount"] * (SIGNALS[0] + n["shift"] * SIGNALS[1]) + n["other"] * SIGNALS[2]

    (effect,) = linearised({candidate: change})
    assert [term.parameter for term in effect.varied] == ["amount", "other", "shift"]
    expected = [2.0 * SIGNALS[0], 0.3 * SIGNALS[2], 2.0 * 0.5 * SIGNALS[1]]
    assert_allclose(effect.columns, expected, atol=1e-12)
    assert_allclose(effect.precision, [prior_precision(p) for p in candidate.parameters])


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


def test_of_several_starts_the_best_is_taken():
    effect, size_, rate_ = tone_of(replace(rate(), high=500.0))
    problem = problem_of(Sums(effect), {size_: 1.0, rate_: 12.0})
    found = fitted(problem, *({size_: 1.0, rate_: r} for r in (1.0, 11.0, 40.0)))
    assert found.values[rate_] == pytest.approx(12.0, rel=0.05)


def test_numbers_stay_in_their_plausible_range():
    simulator = Sums(linear("gain", ["a"], most=0.5))
    problem = problem_of(simulator, {GAIN: 2.0})
    simulator.asked.clear()
    assert fitted(problem, {GAIN: 50.0}).values[GAIN] == 0.5
    assert all(abs(variant[GAIN]) <= 0.5 for variant in simulator.asked)


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


def test_without_effects_only_tolerances_are_fitted():
    off, other = amount("scatter", "a"), amount("scatter", "b")
    problem = problem_of(Sums(PLAIN, scatter(0.5)), {off: 0.8})
    found = refine(problem, {}, [[]])
    assert (found.effects, found.values) == ((), {})
    assert found.tolerances[off] == pytest.approx(0.8, abs=0.05)
    assert found.tolerances[other] == pytest.approx(0.0, abs=0.1)
    assert found.held_out_rmse == pytest.approx(FLOOR, rel=0.15)


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
    for seed in range(60):
        rng = np.random.default_rng([seed, 9])
        left = {amount("scatter", place): rng.normal(0.0, std) for place in "ab"}
        found = fitted(problem_of(simulator, {**truth, **left}, seed), truth)
        inside.append([abs(found.values[t] - v) <= found.deviations[t] for t, v in truth.items()])
    assert (np.mean(inside, axis=0) >= 0.85).all()


@pytest.mark.parametrize("truth", [0.0, -0.05])
def test_a_number_at_its_bound_is_known_as_far_as_the_readings_tell(truth):
    problem = problem_of(Sums(linear("gain", ["a"])), {GAIN: truth})
    found = refine(problem, {GAIN: Parameter("amount", "1", 0.0, 9.0, 1.0, "")}, [[0.5]])
    alone = 1.96 * FLOOR / np.sqrt((SIGNALS[0] ** 2).sum())
    assert found.values[GAIN] < alone
    assert 0.5 * alone < found.deviations[GAIN] < 3.0 * alone


def test_without_a_step_the_numbers_stay():
    problem = problem_of(Sums(linear("gain", ["a", "b"])), {GAIN: 2.0})
    assert refit(problem, {GAIN: 1.0}, 0).values == {GAIN: 1.0}


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


def test_an_effect_that_saturates_starts_smaller_too():
    """At its typical size there is no slope."""
    candidate = Candidate("saturating", ("x",), (size("amount"),), history_dependent=True)
    effect = {candidate: lambda _, numbers: np.tanh(3.0 * numbers["amount"]) * SIGNALS[0]}
    truth = {amount("saturating", "x"): 0.3}
    assert added(effect, truth).values == pytest.approx(truth, rel=0.1)


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


def test_if_every_start_leaves_too_much_there_is_no_fit():
    problem, proposals = proposed({TRIED: FADES}, {AMOUNT: 6.0, RATE: 6.0})
    assert fit(problem, replace(proposals[0], most_left=1e-6)) == []
    assert fit(problem, replace(proposals[0], most_left=1e3)) != []


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
    refined, columns = final_refinement(problem, rough)
    assert not np.allclose(columns, problem.tolerance_columns)
    assert rough.held_out_rmse > 10.0 * FLOOR
    assert refined.held_out_rmse < 1.1 * FLOOR
    assert refined.values[GAIN] == pytest.approx(2.0, abs=0.02)
    assert refined.tolerances[OFF] == pytest.approx(0.05, rel=0.5)
    none = refine(problem, {}, [[]])
    assert final_refinement(problem, none)[0] is none
    simulator.fails = True
    assert problem.cost_of(final_refinement(problem, rough)[0]) <= problem.cost_of(rough)
