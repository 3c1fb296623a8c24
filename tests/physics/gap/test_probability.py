"""Probabilities of hypotheses, and which of them a recording cannot distinguish."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablesense_gap.diagnosis.fitting import refine
from cablesense_gap.diagnosis.probability import (
    UNKNOWN_ALONE,
    Ranked,
    ambiguity,
    bundled_calibration,
    imitated_share,
    near_none,
    posterior,
)
from cablesense_gap.diagnosis.problem import Hypothesis, Problem
from cablesense_gap.diagnosis.search import search
from tests.helpers.gap_problem import SIGNALS, Sums, amount, hypothesis, linear, problem_of

FLOOR = 0.1
BUNDLED = bundled_calibration()

left = st.floats(0.05, 20.0)
explanation_of = cache(hypothesis)
few = settings(deadline=None, max_examples=20)


def leaving(rmse: float, *effects: str) -> Hypothesis:
    """A hypothesis that leaves so much on held-out trials."""
    nothing = explanation_of(*effects)
    return replace(nothing, squares=rmse**2 * nothing.count)


def judged(none: float, **others: float) -> dict[tuple[str, ...], float]:
    hypotheses = [leaving(none)]
    hypotheses += [leaving(rmse, *name.split("_")) for name, rmse in others.items()]
    return {b.effects: b.probability for b in posterior(hypotheses, FLOOR, BUNDLED)}


@given(left, st.lists(left, max_size=4))
@few
def test_probabilities_add_up_to_one_and_stand_in_their_order(none, others):
    hypotheses = [leaving(none), *(leaving(r, n) for r, n in zip(others, "abcd", strict=False))]
    probabilities = [each.probability for each in posterior(hypotheses, FLOOR, BUNDLED)]
    assert sum(probabilities) == pytest.approx(1.0)
    # those that nearly equal the most probable one stand in the order of their residuals
    near = sum(each > 0.9 * max(probabilities) for each in probabilities)
    assert min(probabilities[:near]) > 0.9 * max(probabilities)
    assert probabilities[near:] == sorted(probabilities[near:], reverse=True)
    assert min(probabilities) >= 0.0
    assert len(probabilities) == len(hypotheses) + 1


@pytest.mark.parametrize("better", ["a", "b"])
def test_of_two_that_reach_the_floor_the_one_that_leaves_less_is_first(better):
    rmse_of = {"a": 0.6 * FLOOR, "b": 0.6 * FLOOR, better: 0.5 * FLOOR}
    hypotheses = [leaving(20.0 * FLOOR), *(leaving(rmse, name) for name, rmse in rmse_of.items())]
    assert posterior(hypotheses, FLOOR, BUNDLED)[0].effects == (better,)


def test_of_two_that_reach_the_floor_the_one_with_fewer_sizes_is_first():
    hypotheses = [leaving(10.0), replace(leaving(0.08, "a"), sizes=4), leaving(0.09, "b")]
    ranked = posterior(hypotheses, FLOOR, BUNDLED)
    assert [each.effects for each in ranked[:2]] == [("b",), ("a",)]
    assert ranked[0].probability == pytest.approx(ranked[1].probability, rel=0.2)


@pytest.mark.parametrize(
    ("none", "others", "first"),
    [
        (FLOOR, {"a": FLOOR, "b": FLOOR, "a_b": FLOOR}, ("none",)),
        (3.0, {"a": FLOOR, "b": 2.5, "b_c": 2.0}, ("a",)),
        (3.0, {"a": 0.2, "a_b": 0.2}, ("a",)),
        (3.0, {"a": 1.5, "b": 2.0, "a_b": FLOOR}, ("a", "b")),
        (3.0, {"a": 2.9, "b": 2.9, "a_b": 2.8}, UNKNOWN_ALONE),
    ],
    ids=["nothing left", "one is enough", "the second adds nothing", "two", "none helps"],
)
def test_the_most_probable_explanation(none, others, first):
    probabilities = judged(none, **others)
    assert max(probabilities, key=probabilities.__getitem__) == first
    assert probabilities[first] > 0.5


ONE, OTHER = SIGNALS[:2]


def explained(problem: Problem, effects: str, change: np.ndarray) -> Hypothesis:
    """Effects, joined by `+`, that make one change, with one number each."""
    names = tuple(effects.split("+"))
    nothing = refine(problem, {}, [[]])
    assert nothing is not None
    return replace(
        nothing,
        effects=names,
        values={amount(name, "x"): 1.0 for name in names},
        deviations={amount(name, "x"): 0.1 for name in names},
        nuisance={},
        prediction=problem.nominal + change,
        columns=np.array([change] * len(names)),
        held_out=problem.nominal + change,
        squares=np.full(len(problem.fold), 0.1**2),
        count=np.ones(len(problem.fold)),
    )


def believed(changes: dict[str, np.ndarray], *probabilities: float) -> list[Ranked]:
    return [
        Ranked(tuple(name.split("+")), p, explained(PLAIN, name, change))
        for (name, change), p in zip(changes.items(), probabilities, strict=True)
    ]


def plain(tolerances: dict | None = None) -> Problem:
    return problem_of(Sums(linear("a", ["x"]), tolerances), {amount("a", "x"): 1.0})


PLAIN = plain()


@pytest.mark.parametrize("angle", [0.0, 0.2, 0.8, 1.3, 0.5 * np.pi])
def test_the_share_is_what_lies_in_the_others_direction(angle):
    along = (ONE * OTHER).sum() / (ONE**2).sum()
    across = OTHER - along * ONE
    across *= np.linalg.norm(ONE) / np.linalg.norm(across)
    turned = np.cos(angle) * ONE + np.sin(angle) * across
    share = imitated_share(PLAIN, explained(PLAIN, "a", ONE), explained(PLAIN, "b", turned))
    assert share == pytest.approx(1.0 - np.sin(angle), abs=2e-3)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"a": ONE, "b": 2.0 * ONE}, "b, with its own numbers, imitates 100 % of the"),
        ({"a": ONE, "b": 2.0 * ONE}, "this recording cannot distinguish them"),
        ({"a": ONE, "b": OTHER}, "so they differ; but they leave 0.1 and 0.1 V"),
        ({"a": ONE, "a+b": ONE}, "In addition to a, b reduces the residual"),
        ({"a+b": ONE, "a": ONE}, "In addition to a, b reduces the residual"),
    ],
)
def test_a_rival_has_a_reason(changes, says):
    group, reasons = ambiguity(PLAIN, believed(changes, 0.5, 0.4), unit="V")
    assert group == tuple(changes)
    assert says in reasons[0]


def test_effects_with_one_signal_come_out_of_the_search_as_a_group():
    both = linear("left", ["x"], SIGNALS[:1]) | linear("right", ["x"], SIGNALS[:1])
    problem = problem_of(Sums(both), {amount("left", "x"): 2.0})
    group, reasons = ambiguity(problem, posterior(search(problem), problem.floor, BUNDLED))
    assert sorted(group) == ["left", "right"]
    assert "cannot distinguish" in reasons[0]


def test_effects_near_none_are_worth_another_experiment():
    no_effects = Ranked(("none",), 0.59, leaving(0.1))
    payload = Ranked(("a",), 0.17, leaving(0.1, "a"))
    tilt = Ranked(("b",), 0.02, leaving(0.1, "b"))
    unknown = Ranked(UNKNOWN_ALONE, 0.2, None)
    assert near_none([no_effects, unknown, payload, tilt]) == (payload,)
    assert near_none([payload, no_effects]) == ()
