"""Probabilities of explanations, and which of them a recording cannot distinguish."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest
from gap_problem import SIGNALS, Sums, amount, explanation, linear, problem_of, size
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from cablesense_gap.diagnosis.gauss_newton import refine
from cablesense_gap.diagnosis.probability import (
    LEAST,
    NEAR_BEST,
    PARALLEL,
    UNKNOWN,
    Ranked,
    ambiguity,
    bundled_calibration,
    imitated_share,
    named,
    posterior,
)
from cablesense_gap.diagnosis.problem import Explanation, Problem
from cablesense_gap.diagnosis.search import search
from cablesense_gap.simulator import Candidate

FLOOR = 0.1
NAMES = ("a", "b", "c", "d")
BUNDLED = bundled_calibration()

left = st.floats(0.05, 20.0)


def leaving(rmse: float, *effects: str) -> Explanation:
    """An explanation that leaves so much on held-out trials."""
    nothing = explanation_of(effects)
    return replace(nothing, squares=rmse**2 * nothing.count)


@cache
def explanation_of(effects: tuple[str, ...]) -> Explanation:
    return explanation(*effects)


def judged(none: float, **others: float) -> dict[tuple[str, ...], float]:
    explanations = [leaving(none)]
    explanations += [leaving(rmse, *name.split("_")) for name, rmse in others.items()]
    return {b.effects: b.probability for b in posterior(explanations, FLOOR, BUNDLED)}


@given(left, st.lists(left, max_size=4))
@settings(deadline=None)
def test_probabilities_add_up_to_one_and_stand_in_their_order(none, others):
    explanations = [leaving(none), *(leaving(r, n) for r, n in zip(others, NAMES, strict=False))]
    found = posterior(explanations, FLOOR, BUNDLED)
    probabilities = [ranked.probability for ranked in found]
    assert sum(probabilities) == pytest.approx(1.0)
    assert probabilities == sorted(probabilities, reverse=True)
    assert min(probabilities) >= 0.0
    assert len(found) == len(explanations) + 1


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
    explanations = [leaving(1.0), leaving(0.5, "a")]
    found = {b.effects: b for b in posterior(explanations, FLOOR, BUNDLED)}
    assert found["none",].explanation is explanations[0]
    assert found["a",].explanation is explanations[1]
    assert found[UNKNOWN] == Ranked(UNKNOWN, found[UNKNOWN].probability, None)


def test_the_bundled_numbers_are_all_there():
    values = [getattr(BUNDLED, field.name) for field in fields(BUNDLED)]
    assert all(np.isfinite(values))


ONE, OTHER = SIGNALS[:2]


def explained(
    problem: Problem, effects: str, change: np.ndarray, left: float = 0.1
) -> Explanation:
    """Effects, joined by `+`, that make one change, with one number each."""
    names = tuple(effects.split("+"))
    nothing = refine(problem, {}, [[]])
    assert nothing is not None
    return replace(
        nothing,
        effects=names,
        values={amount(name, "x"): 1.0 for name in names},
        deviations={amount(name, "x"): 0.1 for name in names},
        tolerances={},
        prediction=problem.nominal + change,
        columns=np.array([change] * len(names)),
        held_out=problem.nominal + change,
        squares=np.full(len(problem.fold), left**2),
        count=np.ones(len(problem.fold)),
    )


def believed(
    problem: Problem, changes: dict[str, np.ndarray], *probabilities: float
) -> list[Ranked]:
    return [
        Ranked(tuple(name.split("+")), p, explained(problem, name, change))
        for (name, change), p in zip(changes.items(), probabilities, strict=True)
    ]


def plain(tolerances: dict | None = None) -> Problem:
    return problem_of(Sums(linear("a", ["x"]), tolerances), {amount("a", "x"): 1.0})


def workshop(std: float, signal: np.ndarray) -> dict:
    candidate = Candidate("workshop", ("arm",), (size("amount", std),))
    return {candidate: lambda place, numbers: numbers["amount"] * signal}


PLAIN = plain()


@given(st.floats(-30.0, 30.0).filter(lambda scale: abs(scale) > 1e-3))
def test_the_same_change_is_imitated_whole_whatever_its_size(scale):
    one, other = explained(PLAIN, "a", ONE), explained(PLAIN, "b", scale * ONE)
    assert imitated_share(PLAIN, one, other) == pytest.approx(1.0, abs=2e-3)


@given(st.floats(0.0, 0.5 * np.pi))
def test_the_share_is_what_lies_in_the_others_direction(angle):
    along = (ONE * OTHER).sum() / (ONE**2).sum()
    across = OTHER - along * ONE
    across *= np.linalg.norm(ONE) / np.linalg.norm(across)
    turned = np.cos(angle) * ONE + np.sin(angle) * across
    share = imitated_share(PLAIN, explained(PLAIN, "a", ONE), explained(PLAIN, "b", turned))
    assert share == pytest.approx(1.0 - np.sin(angle), abs=2e-3)


def test_more_numbers_imitate_more():
    one, other = explained(PLAIN, "a", ONE + OTHER), explained(PLAIN, "b", ONE)
    free = replace(other, columns=np.array([ONE, OTHER]))
    assert imitated_share(PLAIN, one, other) < 0.6
    assert imitated_share(PLAIN, one, free) == pytest.approx(1.0, abs=2e-3)


def test_tolerances_make_unlike_changes_alike_only_as_far_as_a_workshop_leaves():
    shares = []
    for std in (1e-4, 10.0):
        problem = plain(workshop(std, OTHER))
        one, other = explained(problem, "a", ONE + 0.5 * OTHER), explained(problem, "b", ONE)
        shares.append(imitated_share(problem, one, other))
    assert shares[0] < 0.7
    assert shares[1] > 0.99


def test_rows_that_do_not_count_do_not_tell_apart():
    problem = replace(PLAIN, used=np.arange(len(ONE)) >= 40)
    apart = ONE.copy()
    apart[:40] = 9.0
    one, other = explained(problem, "a", apart), explained(problem, "b", ONE)
    assert imitated_share(problem, one, other) == pytest.approx(1.0, abs=2e-3)
    assert imitated_share(PLAIN, one, other) < PARALLEL


def test_a_clear_verdict_is_alone():
    group, reasons = ambiguity(PLAIN, believed(PLAIN, {"a": ONE, "b": ONE}, 0.93, 0.07))
    assert group == ("a",)
    assert reasons == ()


@pytest.mark.parametrize(("second", "group"), [(0.3, ("a", "b+c")), (0.05, ("a",))])
def test_a_rival_is_near_the_best_in_probability(second, group):
    ranked = believed(PLAIN, {"a": ONE, "b+c": OTHER}, 0.6, second)
    assert ambiguity(PLAIN, ranked)[0] == group
    assert (second >= max(LEAST, NEAR_BEST * 0.6)) == (len(group) == 2)


@pytest.mark.parametrize("name", ["none", "unknown"])
@pytest.mark.parametrize("leads", [True, False])
def test_ways_out_are_in_no_group(name, leads):
    out = explained(PLAIN, name, 0.0 * ONE)
    without = replace(out, effects=()) if name == "none" else None
    way_out = Ranked((name,), 0.52, without)
    named = believed(PLAIN, {"a": ONE}, 0.48)
    ranked = [way_out, *named] if leads else [*named, way_out]
    assert ambiguity(PLAIN, ranked)[0] == ((name,) if leads else ("a",))


def test_the_reason_of_alike_effects_is_that_one_imitates_the_other():
    _, reasons = ambiguity(PLAIN, believed(PLAIN, {"a": ONE, "b": 2.0 * ONE}, 0.5, 0.4))
    assert len(reasons) == 1
    assert "b, with numbers of its own, imitates 100 % of the" in reasons[0]
    assert "shows both alike" in reasons[0]


def test_the_reason_of_unlike_effects_is_what_both_leave():
    _, reasons = ambiguity(PLAIN, believed(PLAIN, {"a": ONE, "b": OTHER}, 0.5, 0.4), unit="V")
    assert "so they differ; yet they leave 0.1 and 0.1 V" in reasons[0]


@pytest.mark.parametrize("order", [("a", "a+b"), ("a+b", "a")])
def test_the_reason_beside_a_further_effect_is_what_that_one_adds(order):
    group, reasons = ambiguity(PLAIN, believed(PLAIN, dict.fromkeys(order, ONE), 0.5, 0.4))
    assert group == order
    assert reasons[0].startswith("Beside a, b takes what is left")


def test_effects_with_one_signal_come_out_of_the_search_as_a_group():
    both = linear("left", ["x"], SIGNALS[:1]) | linear("right", ["x"], SIGNALS[:1])
    problem = problem_of(Sums(both), {amount("left", "x"): 2.0})
    group, reasons = ambiguity(
        problem, posterior(search(problem), problem.floor, bundled_calibration())
    )
    assert sorted(group) == ["left", "right"]
    assert "alike" in reasons[0]


@pytest.mark.parametrize(
    ("differs", "leaves", "told"),
    [
        ("history_dependent", 2.0, ("a",)),
        ("history_dependent", 2.4, UNKNOWN),
        ("against_motion", 2.0, ("a",)),
        (None, 2.0, UNKNOWN),
    ],
)
def test_what_one_effect_makes_of_past_and_direction_is_no_imitation(differs, leaves, told):
    candidate = Candidate("a", ("arm",), (), **({differs: True} if differs else {}))
    problem = problem_of(Sums({candidate: lambda _: 0.0 * ONE}), {})
    explanations = [leaving(3.0), leaving(leaves, "a")]
    found = named(problem, posterior(explanations, FLOOR, BUNDLED), BUNDLED)
    assert found[0].effects == told
    assert sum(each.probability for each in found) == pytest.approx(1.0)


def verdict_on(whole: float, without: float) -> list[Ranked]:
    """Three effects that leave so much of 3 N, and so much without any one of them."""
    explanations = [leaving(3.0), leaving(whole, "a", "b", "c")]
    explanations += [leaving(without, *pair) for pair in (("a", "b"), ("a", "c"), ("b", "c"))]
    problem = problem_of(Sums({}), {})
    return named(problem, posterior(explanations, FLOOR, BUNDLED), BUNDLED)


def test_several_effects_are_named_beside_what_stays_unexplained():
    found = verdict_on(whole=0.9, without=2.0)
    assert found[0].effects == ("a", "b", "c")
    assert sum(each.probability for each in found) == pytest.approx(1.0)


@pytest.mark.parametrize(("whole", "without"), [(1.8, 2.9), (0.9, 1.1)])
def test_effects_that_leave_much_or_are_not_needed_stand_in_for_an_unlisted_one(whole, without):
    assert verdict_on(whole, without)[0].effects == UNKNOWN


def test_of_what_is_borne_out_the_explanation_that_leaves_least_is_named():
    """A single effect of the past is more probable than three of many numbers that do better."""
    past = Candidate("past", ("arm",), (), history_dependent=True)
    whole = replace(leaving(0.9, "a", "b", "c"), sizes=30)
    pairs = [leaving(2.0, *pair) for pair in (("a", "b"), ("a", "c"), ("b", "c"))]
    explanations = [leaving(3.0), leaving(1.9, "past"), whole, *pairs]
    found = posterior(explanations, FLOOR, BUNDLED)
    assert [each.effects for each in found[:2]] == [UNKNOWN, ("past",)]
    problem = problem_of(Sums({past: lambda _: 0.0 * ONE}), {})
    assert named(problem, found, BUNDLED)[0].effects == ("a", "b", "c")
