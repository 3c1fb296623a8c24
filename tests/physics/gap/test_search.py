"""The search: what is fitted, in which order, and what it ends with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cablesense_gap.diagnosis.problem import Past, subsampled
from cablesense_gap.diagnosis.search import search
from cablesense_gap.simulator import Candidate, Term
from cablesense_sim.effects.effect import Parameter
from tests.helpers.gap_problem import (
    FLOOR,
    SIGNALS,
    TIME,
    TRIAL,
    Sums,
    amount,
    fading,
    linear,
    problem_of,
    several,
    size,
)

PLAIN = linear("gain", "abc")
((FADING, FADES),) = fading("fading", "xy", history_dependent=True).items()
AMOUNT = amount("fading", "x")
RATE = Term("fading", "x", "rate")


LIBRARY = {
    **linear("gain", ["a", "b", "c"], SIGNALS[:3]),
    **linear("zero", ["a", "b"], SIGNALS[3:5]),
    **fading("fading", ["x", "y"], history_dependent=True),
}
GAIN_A = amount("gain", "b")
FADING_X = {Term("fading", "x", "amount"): 3.0, Term("fading", "x", "rate"): 4.0}


def searched(truth, library=LIBRARY):
    return search(problem_of(Sums(library), truth))


def best(found):
    return min(found, key=lambda h: h.held_out_rmse)


def test_one_effect_is_found_in_its_place_and_no_second_is_added():
    best_fit = searched({GAIN_A: 1.0})
    assert best_fit[0].effects == ()  # tolerances alone stand first
    assert best(best_fit).effects == ("gain",)
    assert {term.place for term in best(best_fit).values} == {"b"}
    assert all(len(h.effects) < 2 for h in best_fit)


def test_a_history_dependent_effect_is_found_with_its_shape():
    assert best(searched(FADING_X)).values == pytest.approx(FADING_X, rel=0.15)


def test_an_effect_of_the_past_far_above_the_floor_is_found_beside_a_much_larger_gap():
    """What the gain leaves is two hundredths of the gap, and several floors."""
    faint = {AMOUNT: 0.8, RATE: 4.0}
    without_faint = best(searched({GAIN_A: 30.0})).held_out_rmse
    best_fit = best(searched({GAIN_A: 30.0, **faint}))
    assert best_fit.effects == ("fading", "gain")
    assert best_fit.held_out_rmse < 1.1 * without_faint
    assert {t: best_fit.values[t] for t in faint} == pytest.approx(faint, rel=0.15)


def test_where_readings_return_effects_of_the_past_are_not_simulated():
    problem = problem_of(
        Sums(LIBRARY), SIGNALS[1] + np.outer(np.sin(40.0 * TIME), [1.0, 1.0, 1.0])
    )
    search(replace(problem, past=Past(0.05 * FLOOR, problem.used)))
    assert not any(t.effect == "fading" for v in problem.simulator.asked for t in v)
    search(problem)
    assert any(t.effect == "fading" for v in problem.simulator.asked for t in v)


class OnSomeRows(Sums):
    """The same mechanism that goes through some of the rows alone."""

    def predict(self, variants):
        return super().predict(variants)[:, ROWS_OF_THE_SUBSAMPLE]


ROWS_OF_THE_SUBSAMPLE = np.flatnonzero(np.isin(np.arange(len(TRIAL)) % 20, [0, 1, 3, 7, 12, 19]))


def test_what_a_subsample_chooses_is_scored_on_all_rows():
    problem = problem_of(Sums(LIBRARY), {GAIN_A: 1.0, **FADING_X})
    on_some = OnSomeRows(LIBRARY)
    best_fit = best(search(subsampled(problem, on_some, ROWS_OF_THE_SUBSAMPLE)))
    assert best_fit.effects == ("fading", "gain")
    assert best_fit.held_out.shape == problem.readings.shape
    assert best_fit.count.sum() == problem.readings.size
    assert best_fit.held_out_rmse < 1.2 * FLOOR
    whole = [v for v in problem.simulator.asked if any(t.effect == "fading" for t in v)]
    assert len(whole) < 0.1 * len(on_some.asked)


def test_processes_that_share_a_subsample_find_the_same():
    problem = problem_of(Sums(LIBRARY), {GAIN_A: 1.0, **FADING_X})
    one, two = (
        best(
            search(
                subsampled(problem, OnSomeRows(LIBRARY), ROWS_OF_THE_SUBSAMPLE), workers=workers
            )
        )
        for workers in (1, 2)
    )
    assert one.values == two.values
    np.testing.assert_array_equal(one.held_out, two.held_out)


KIND = Parameter("kind", "1", 0.0, 1.0, 0.5, "between two kinds", 0.0, "shape", (0.0, 1.0))


def of_two_kinds(place, numbers):
    """A small one of kind 1 looks like a large one of kind 0; between them are worse ones."""
    amount = numbers["amount"]
    kind = numbers["kind"]
    of_kind_0 = 0.1 * amount**2 * SIGNALS[1] + amount * np.exp(-abs(amount)) * SIGNALS[2]
    of_kind_1 = amount * (0.9 * SIGNALS[1] + 0.2 * SIGNALS[3])
    between = np.sin(np.pi * kind) * amount * SIGNALS[4]
    return (1.0 - kind) * of_kind_0 + kind * of_kind_1 + between


def test_a_shape_is_found_that_no_small_step_from_its_imitation_leads_to():
    library = {Candidate("kinds", ("a",), (size("amount"), KIND)): of_two_kinds}
    truth = {Term("kinds", "a", "amount"): 10.0, Term("kinds", "a", "kind"): 0.0}
    best_fit = best(searched(truth, library))
    assert best_fit.values == pytest.approx(truth, abs=0.05)


def test_a_second_effect_that_has_nothing_to_do_is_not_named():
    teeth = np.outer(np.sin(40.0 * TIME), [1.0, 1.0, 1.0])
    assert all(len(h.effects) < 2 for h in searched(SIGNALS[1] + teeth))


def test_a_candidate_that_cannot_be_simulated_is_passed_over():
    broken = Candidate("broken", ("x",), (size("amount"),))
    best_fit = searched({GAIN_A: 1.0}, {broken: lambda *_: np.nan * SIGNALS[0], **LIBRARY})
    assert best(best_fit).effects == ("gain",)
    assert not any("broken" in h.effects for h in best_fit)


@pytest.mark.slow  # the whole search, five effects deep
def test_five_effects_at_once_are_found_with_their_sizes_and_nothing_else():
    library = several(5) | PLAIN
    truth = {
        amount(name, "b"): size for name, size in zip("defgh", (3, -2, 1.5, 1, 2), strict=True)
    }
    hypotheses = search(problem_of(Sums(library), truth))
    best = min(hypotheses, key=lambda h: h.held_out_rmse)
    assert best.effects == tuple("defgh")
    assert best.values == pytest.approx(truth, abs=0.05)
    without = {h.effects: h.held_out_rmse for h in hypotheses}
    for name in "defgh":
        assert all(left > 5.0 * best.held_out_rmse for e, left in without.items() if name not in e)


@pytest.mark.slow  # the whole search, twice as deep
@pytest.mark.parametrize(
    ("subsample", "others"),
    [(False, (3, -2, 1.5)), (True, (1.2, -1, 1.1))],
    ids=["large", "small"],
)
def test_what_depends_on_history_is_found_beside_several_others(subsample, others):
    library = several(3) | {FADING: FADES}
    linear_truth = {amount(n, "b"): size for n, size in zip("def", others, strict=True)}
    truth = {**linear_truth, AMOUNT: 4.0, RATE: 3.0}
    problem = problem_of(Sums(library), truth)
    if subsample:
        problem = subsampled(problem, OnSomeRows(library), ROWS_OF_THE_SUBSAMPLE)
    best_fit = best(search(problem))
    assert best_fit.effects == ("d", "e", "f", "fading")
    assert best_fit.values == pytest.approx(truth, rel=0.1)


def unlike(count, seed):
    return np.random.default_rng(seed).normal(size=(count, *SIGNALS.shape[1:]))


def test_an_effect_in_most_of_its_places_is_found_in_all_of_them():
    """In addition to something that no effect explains."""
    places = [f"p{k}" for k in range(12)]
    simulator = Sums(linear("gain", "ab") | linear("drift", places, unlike(12, 1)))
    truth = {amount("gain", "b"): 3.0} | {amount("drift", place): 1.0 for place in places[:10]}
    unexplained = 1.3 * unlike(1, 2)[0]
    predicted = best(search(problem_of(simulator, simulator.predict([truth])[0] + unexplained)))
    assert set(predicted.values) == truth.keys()
