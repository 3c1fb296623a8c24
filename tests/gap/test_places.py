"""Columns are what each number changes, place by place; planted places are found."""

from __future__ import annotations

import numpy as np
import pytest
from gap_problem import SIGNALS, TIME, TRIAL, Sums, amount, fading, linear, problem_of, size
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from cablesense_gap.diagnosis.places import linear_effects, place
from cablesense_gap.diagnosis.problem import prior_precision, to_scaled
from cablesense_gap.simulator import Candidate, Term
from cablesense_sim.effects.effect import Parameter


def linearised(effects):
    simulator = Sums(effects)
    return linear_effects(problem_of(simulator, {}), simulator.candidates[0])


def test_a_linear_effect_has_its_signals_as_columns():
    (found,) = linearised(linear("gain", ["x", "y", "z"]))
    assert [block.place for block in found] == ["x", "y", "z"]
    for block, signal in zip(found, SIGNALS, strict=False):
        assert_allclose(block.columns, signal[None], atol=1e-12)
        assert block.terms == (Term("gain", block.place, "amount"),)
        assert_allclose(block.start, 0.0)


def test_a_column_is_the_change_of_a_typical_size():
    candidate = Candidate("gain", ("x",), (size("amount", typical=0.2),))
    ((block,),) = linearised({candidate: lambda _, numbers: numbers["amount"] * SIGNALS[0]})
    assert_allclose(block.columns[0], 0.2 * SIGNALS[0])


def test_every_starting_shape_has_blocks_of_its_own():
    effect = fading("fading", ["x", "y"])
    (candidate,) = effect
    parameters = candidate.parameters[0], Parameter(
        "rate", "1", 0.1, 50.0, 3.0, "rate", 3.0, "shape", starts=(1.0, 8.0)
    )  # fmt: skip
    effect = {Candidate("fading", ("x", "y"), parameters): effect[candidate]}
    found = linearised(effect)
    assert len(found) == 2
    for some, rate in zip(found, (1.0, 8.0), strict=True):
        for block, signal in zip(some, SIGNALS[6:], strict=True):
            assert_allclose(block.columns, [np.exp(-rate * TIME)[:, None] * signal])
            assert_allclose(block.start, [0.0, np.log(rate)])
            assert block.probed == ("amount",)


@pytest.mark.parametrize("history_dependent", [False, True])
def test_side_by_side_is_as_one_by_one(history_dependent):
    (found,) = linearised(fading("fading", ["x", "y"], history_dependent=history_dependent))
    for block, signal in zip(found, SIGNALS[6:], strict=True):
        assert_allclose(block.columns, [np.exp(-2.0 * TIME)[:, None] * signal], atol=1e-12)


def test_history_dependent_effects_are_simulated_at_one_go():
    simulator = Sums(fading("fading", ["x", "y"], history_dependent=True))
    problem = problem_of(simulator, {})
    simulator.asked.clear()
    linear_effects(problem, simulator.candidates[0])
    assert len(simulator.asked) == 2
    assert len({frozenset(variant) for variant in simulator.asked}) == 1


def test_a_shape_that_may_be_zero_is_linearised_beside_a_size():
    shift = Parameter("shift", "1", -2.0, 2.0, 0.5, "shift", 0.0, "shape")
    candidate = Candidate("moved", ("x",), (size("amount", 2.0), shift))
    ((block,),) = linearised(
        {candidate: lambda _, n: n["amount"] * (SIGNALS[0] + n["shift"] * SIGNALS[1])}
    )
    assert block.probed == ("amount", "shift")
    assert_allclose(block.columns[0], 2.0 * SIGNALS[0])
    assert_allclose(block.columns[1], 2.0 * 0.5 * SIGNALS[1], atol=1e-12)


def test_two_sizes_are_linearised_apart():
    candidate = Candidate("tilt", ("x",), (size("roll", 0.1), size("pitch", 0.3)))
    ((block,),) = linearised(
        {candidate: lambda _, n: n["roll"] * SIGNALS[0] + n["pitch"] * SIGNALS[1]}
    )
    assert_allclose(block.columns, [0.1 * SIGNALS[0], 0.3 * SIGNALS[1]])
    expected = [prior_precision(p) for p in candidate.parameters]
    assert_allclose(block.precision, expected)


def test_places_that_cannot_be_simulated_are_left_out():
    candidate = Candidate("gain", ("x", "broken", "z"), (size("amount"),))

    def change(place, numbers):
        return numbers["amount"] * (np.nan if place == "broken" else SIGNALS[0])

    (found,) = linearised({candidate: change})
    assert [block.place for block in found] == ["x", "z"]


def test_a_start_is_in_scaled_numbers():
    effect = fading("fading", ["x"])
    ((block,),) = linearised(effect)
    rate = next(iter(effect)).parameters[1]
    assert block.start[1] == to_scaled(rate, 2.0)


PLACES = tuple("abcdefgh")
SPREAD = linear("gain", PLACES)
NOTHING = np.empty((0, *SIGNALS[0].shape))


def placed(effects, truth, *, beside=NOTHING, seed=0):
    simulator = Sums(effects)
    problem = problem_of(simulator, truth, seed)
    offered = linear_effects(problem, simulator.candidates[0])[0]
    return place(problem, problem.readings - problem.nominal, beside, offered)[0]


def places(found):
    return {block.place for block in found.chosen}


@pytest.mark.slow
@given(
    st.dictionaries(st.sampled_from(PLACES), st.sampled_from([-1.5, -0.4, 0.3, 2.0]), min_size=1,
                    max_size=4),
    st.integers(0, 100),
)  # fmt: skip
@settings(max_examples=25, deadline=None)
def test_planted_places_are_found_and_no_others(truth, seed):
    found = placed(SPREAD, {amount("gain", p): value for p, value in truth.items()}, seed=seed)
    assert places(found) == set(truth)
    for block, coefficient in zip(found.chosen, found.coefficients, strict=True):
        assert coefficient == pytest.approx(truth[block.place], abs=0.05)


def test_the_first_place_is_the_one_that_explains_most():
    found = placed(SPREAD, {amount("gain", "c"): 0.3, amount("gain", "f"): 2.0})
    assert [block.place for block in found.chosen] == ["f", "c"]


@pytest.mark.parametrize("seed", range(5))
def test_noise_gets_one_place_and_no_more(seed):
    assert len(placed(SPREAD, {}, seed=seed).chosen) == 1


def test_what_is_everywhere_is_not_taken_apart():
    everywhere = linear("gain", ("arm", *PLACES[:4]))
    found = placed(everywhere, {amount("gain", "arm"): 0.5})
    assert places(found) == {"arm"}
    assert found.coefficients == pytest.approx([0.5], abs=0.02)


def test_what_is_in_one_place_is_not_everywhere():
    everywhere = linear("gain", ("arm", *PLACES[:4]))
    assert places(placed(everywhere, {amount("gain", "b"): 0.5})) == {"b"}


def test_what_is_left_is_the_noise_where_the_effect_is_the_cause():
    found = placed(SPREAD, {amount("gain", "d"): 1.0})
    assert found.mean_square == pytest.approx(0.1**2, rel=0.15)


def test_what_other_effects_explain_is_not_counted_twice():
    """Beside an effect that is there already, only what it leaves is to be explained."""
    truth = 3.0 * SIGNALS[7] + 0.5 * SIGNALS[1]
    alone = placed(linear("gain", PLACES[:4]), truth)
    beside = placed(linear("gain", PLACES[:4]), truth, beside=SIGNALS[7:8])
    assert places(beside) == {"b"}
    assert beside.coefficients == pytest.approx([0.5], abs=0.05)
    assert beside.mean_square < 0.1 * alone.mean_square


def test_without_a_place_there_is_nothing():
    problem = problem_of(Sums(SPREAD), {})
    assert place(problem, problem.readings, NOTHING, []) == []


def test_a_place_that_explains_nearly_as_much_follows():
    """Two signals that are all but parallel, and a third that is not."""
    signals = np.array([SIGNALS[0], SIGNALS[0] + 0.03 * SIGNALS[1], SIGNALS[2]])
    simulator = Sums(linear("gain", "abc", signals))
    problem = problem_of(simulator, {amount("gain", "a"): 1.0})
    offered = linear_effects(problem, simulator.candidates[0])[0]
    best, second = place(problem, problem.readings, NOTHING, offered)
    assert places(best) == {"a"}
    assert places(second) == {"b"}
    assert second.mean_square >= best.mean_square


def test_what_holds_in_one_trial_alone_is_no_place():
    """It fits what it was fitted to, and fails on all trials that were held out."""
    once = np.array([SIGNALS[0], SIGNALS[1] * (TRIAL == 3)[:, None]])
    effects = linear("gain", ("a", "b"), once)
    assert places(placed(effects, {amount("gain", "a"): 1.0, amount("gain", "b"): 1.0})) == {"a"}


def test_two_places_of_which_either_alone_explains_nothing_are_found_together():
    """Two cables that pull against each other: their difference is all that is seen."""
    alike = SIGNALS[0] + SIGNALS[1]
    signals = np.array([10.0 * alike + SIGNALS[2], -10.0 * alike, SIGNALS[3], SIGNALS[4]])
    truth = {amount("gain", "a"): 1.0, amount("gain", "b"): 1.0, amount("gain", "c"): 3.0}
    found = placed(linear("gain", "abcd", signals), truth)
    assert places(found) == {"a", "b", "c"}
