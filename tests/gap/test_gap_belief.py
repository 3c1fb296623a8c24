"""Probabilities of explanations, whatever the calibrated numbers are."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest
from gap_course import explanation
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from cablesense_gap.diagnosis.belief import UNKNOWN, Belief, beliefs, bundled_calibration
from cablesense_gap.diagnosis.problem import Hypothesis

FLOOR = 0.1
NAMES = ("a", "b", "c", "d")
BUNDLED = bundled_calibration()

left = st.floats(0.05, 20.0)


def leaving(rmse: float, *effects: str) -> Hypothesis:
    """An explanation that leaves so much on held-out trials."""
    nothing = explanation_of(effects)
    return replace(nothing, squares=rmse**2 * nothing.count)


@cache
def explanation_of(effects: tuple[str, ...]) -> Hypothesis:
    return explanation(*effects)


def judged(none: float, **others: float) -> dict[tuple[str, ...], float]:
    hypotheses = [leaving(none)]
    hypotheses += [leaving(rmse, *name.split("_")) for name, rmse in others.items()]
    return {b.effects: b.probability for b in beliefs(hypotheses, FLOOR, BUNDLED)}


@given(left, st.lists(left, max_size=4))
@settings(deadline=None)
def test_probabilities_add_up_to_one_and_stand_in_their_order(none, others):
    hypotheses = [leaving(none), *(leaving(r, n) for r, n in zip(others, NAMES, strict=False))]
    found = beliefs(hypotheses, FLOOR, BUNDLED)
    probabilities = [belief.probability for belief in found]
    assert sum(probabilities) == pytest.approx(1.0)
    assert probabilities == sorted(probabilities, reverse=True)
    assert min(probabilities) >= 0.0
    assert len(found) == len(hypotheses) + 1


@given(left, left, left, left)
@settings(deadline=None)
def test_what_leaves_more_is_never_more_probable(none, one, other, third):
    less, more = sorted((one, other))
    assume(more - less > 1e-9)
    near, far = judged(none, a=less, b=third), judged(none, a=more, b=third)
    assert far["a",] <= near["a",] + 1e-12
    assert far["b",] >= near["b",] - 1e-12


@given(left, left, left)
@settings(deadline=None)
def test_of_two_effects_the_one_that_leaves_less_is_ahead(none, one, other):
    found = judged(none, a=one, b=other)
    assert (found["a",] - found["b",]) * (one - other) <= 1e-12


def test_where_nothing_is_left_it_is_none():
    found = judged(FLOOR, a=FLOOR, b=FLOOR, a_b=FLOOR)
    assert max(found, key=found.__getitem__) == ("none",)


def test_where_one_effect_leaves_nothing_it_is_that_effect():
    found = judged(3.0, a=FLOOR, b=2.5, b_c=2.0)
    assert found["a",] > 0.5


def test_where_no_effect_helps_it_is_unknown():
    found = judged(3.0, a=2.9, b=2.9, a_b=2.8)
    assert max(found, key=found.__getitem__) == UNKNOWN


def test_the_more_every_effect_leaves_the_more_probable_is_an_unknown_one():
    probabilities = [judged(5.0, a=5.0 * share)[UNKNOWN] for share in (0.05, 0.2, 0.5, 0.9, 1.0)]
    assert probabilities == sorted(probabilities)
    assert probabilities[-1] > 5.0 * probabilities[0]


def test_two_effects_that_leave_no_less_than_one_are_less_probable():
    found = judged(3.0, a=0.2, a_b=0.2)
    assert found["a",] > found["a", "b"]


def test_two_effects_are_believed_where_one_leaves_much():
    found = judged(3.0, a=1.5, b=2.0, a_b=FLOOR)
    assert found["a", "b"] > 0.5


def test_every_belief_has_its_hypothesis_but_for_an_unknown_effect():
    hypotheses = [leaving(1.0), leaving(0.5, "a")]
    found = {b.effects: b for b in beliefs(hypotheses, FLOOR, BUNDLED)}
    assert found["none",].hypothesis is hypotheses[0]
    assert found["a",].hypothesis is hypotheses[1]
    assert found[UNKNOWN] == Belief(UNKNOWN, found[UNKNOWN].probability, None)


def test_the_bundled_numbers_are_all_there():
    values = [getattr(BUNDLED, field.name) for field in fields(BUNDLED)]
    assert all(np.isfinite(values))
