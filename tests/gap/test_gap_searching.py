"""The search over candidates: what is fitted, and in which order."""

from __future__ import annotations

import numpy as np
from gap_course import FLOOR, SIGNALS, TIME, Sums, amount, course_of, fading, linear, size

from cablesense_gap.diagnosis.search import search
from cablesense_gap.simulator import Candidate, Term

LIBRARY = {
    **linear("gain", ["a", "b", "c"], SIGNALS[:3]),
    **linear("zero", ["a", "b"], SIGNALS[3:5]),
    **fading("fading", ["x", "y"], remembers=True),
}
GAIN, ZERO = amount("gain", "b"), amount("zero", "a")
FADING = {Term("fading", "x", "amount"): 3.0, Term("fading", "x", "rate"): 4.0}


def searched(truth, library=LIBRARY):
    return search(course_of(Sums(library), truth))


def best(found):
    return min(found, key=lambda h: h.held_out_rmse)


def test_tolerances_alone_stand_first():
    found = searched({GAIN: 1.0})
    assert found[0].effects == ()
    assert all(h.effects for h in found[1:])


def test_one_effect_is_found_in_its_place():
    found = best(searched({GAIN: 1.0}))
    assert found.effects == ("gain",)
    assert found.places == ("b",)


def test_an_effect_that_remembers_is_found_with_its_shape():
    found = best(searched(FADING))
    assert found.effects == ("fading",)
    for term, value in FADING.items():
        np.testing.assert_allclose(found.values[term], value, rtol=0.15)


def test_two_effects_are_found_together():
    found = best(searched({GAIN: 1.0, **FADING}))
    assert found.effects == ("fading", "gain")
    assert found.held_out_rmse < 1.2 * FLOOR


def test_no_second_effect_is_sought_where_one_leaves_nothing():
    assert all(len(h.effects) < 2 for h in searched({GAIN: 1.0}))


def test_pairs_are_sought_where_something_is_left():
    teeth = np.outer(np.sin(40.0 * TIME), [1.0, 1.0, 1.0])
    told = []
    search(course_of(Sums(LIBRARY), SIGNALS[1] + teeth), lambda what, _: told.append(what))
    assert "fitting pairs of effects" in told


def test_a_second_effect_that_has_nothing_to_do_is_not_named():
    teeth = np.outer(np.sin(40.0 * TIME), [1.0, 1.0, 1.0])
    assert all(len(h.effects) < 2 for h in searched(SIGNALS[1] + teeth))


def test_no_hypothesis_stands_twice():
    named = [h.effects for h in searched({GAIN: 1.0, ZERO: 0.7})]
    assert len(named) == len(set(named))
    assert all(list(effects) == sorted(effects) for effects in named)


def test_a_candidate_that_cannot_be_simulated_is_passed_over():
    broken = Candidate("broken", ("x",), (size("amount"),))
    found = searched({GAIN: 1.0}, {broken: lambda *_: np.nan * SIGNALS[0], **LIBRARY})
    assert best(found).effects == ("gain",)
    assert not any("broken" in h.effects for h in found)


def test_without_candidates_there_are_tolerances_alone():
    assert [h.effects for h in searched(SIGNALS[0], {})] == [()]
