"""Planted effects and places are chosen, and no others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_gap.diagnosis.fitting import refine
from cablesense_gap.diagnosis.selection import Selection, linear_effects
from cablesense_gap.simulator import Candidate
from tests.helpers.gap_problem import SIGNALS, Sums, amount, linear, problem_of, size

PLACES = tuple("abcdefgh")
SPREAD = linear("gain", PLACES)
GAINS = linear("gain", "abcd")
ZEROS = linear("zero", "abcd", SIGNALS[4:])
EVERYWHERE = linear("gain", ("arm", "a", "b", "c", "d"))
SIZES = st.sampled_from([-1.5, -0.4, 0.4, 2.0])


def selection(problem, about=None):
    about = about or refine(problem, {}, [[]])
    offered = [e for c in problem.simulator.candidates for e in linear_effects(problem, c)]
    return Selection(problem, about, [e for e in offered if e.effect not in about.effects])


def sizes_of(proposal):
    terms = [effect.terms[0] for effect in proposal.added]
    return dict(zip(terms, proposal.coefficients, strict=True))


def added(effects, truth, seed=0):
    """Sizes in the best addition to the nominal mechanism."""
    return sizes_of(selection(problem_of(Sums(effects), truth, seed)).additions()[0])


def as_planted(found, truth):
    """A site that chance added may stay, with next to nothing in it."""
    return found == pytest.approx({**dict.fromkeys(found, 0.0), **truth}, abs=0.05)


def planted(gains, zeros=()):
    zeros = dict(zeros)
    return {amount("gain", p): v for p, v in gains.items()} | {
        amount("zero", p): v for p, v in zeros.items()
    }


@given(
    st.dictionaries(st.sampled_from(PLACES), SIZES, min_size=1, max_size=4), st.integers(0, 100)
)
@settings(max_examples=15, deadline=None)
def test_planted_places_are_found_and_no_others(truth, seed):
    truth = planted(truth)
    assert as_planted(added(SPREAD, truth, seed), truth)


@given(
    st.dictionaries(st.sampled_from("abcd"), SIZES, min_size=1, max_size=2),
    st.dictionaries(st.sampled_from("abcd"), SIZES, min_size=1, max_size=2),
    st.integers(0, 100),
)
@settings(max_examples=15, deadline=None)
def test_planted_pairs_are_found_with_all_places(gains, zeros, seed):
    truth = planted(gains, zeros)
    assert as_planted(added({**GAINS, **ZEROS}, truth, seed), truth)


@pytest.mark.parametrize("gains", [{"arm": 0.5}, {"b": 0.5}, {"a": 0.5, "d": -0.8}])
@pytest.mark.parametrize("zeros", [{}, {"b": 1.0}])
def test_an_effect_is_everywhere_or_in_places(gains, zeros):
    truth = planted(gains, zeros)
    assert added({**EVERYWHERE, **ZEROS}, truth) == pytest.approx(truth, abs=0.05)


def test_two_places_of_which_either_alone_explains_nothing_are_found_together():
    """Two cables that pull against each other: only their difference shows."""
    alike = SIGNALS[0] + SIGNALS[1]
    signals = np.array([10.0 * alike + SIGNALS[2], -10.0 * alike, SIGNALS[3], SIGNALS[4]])
    truth = planted({"a": 1.0, "b": 1.0, "c": 3.0})
    assert set(added(linear("gain", "abcd", signals), truth)) == set(truth)


def test_a_size_that_cannot_be_is_no_site():
    """The signal of "a" would have to be taken away, which it cannot be."""
    candidate = Candidate("load", ("a", "b"), (replace(size("amount"), low=0.0),))
    by_place = dict(zip("ab", SIGNALS, strict=False))
    library = {candidate: lambda place, numbers: numbers["amount"] * by_place[place]}
    assert set(added(library, 2.0 * SIGNALS[1] - 3.0 * SIGNALS[0])) == {amount("load", "b")}


def test_a_column_is_taken_where_its_change_suits_the_residual():
    """Far from the planted size the effect has another pattern, as if cables became slack."""

    def bent(_, numbers):
        near = np.clip(numbers["amount"], -1.0, 1.0)
        return near * SIGNALS[0] + (numbers["amount"] - near) * SIGNALS[1]

    library = {Candidate("shift", ("arm",), (size("amount", typical=10.0),)): bent}
    truth = {amount("shift", "arm"): 0.8}
    columns = added(library | linear("gain", "ab", SIGNALS[1:]), truth)
    assert columns == pytest.approx({amount("shift", "arm"): 0.08}, abs=0.005)
