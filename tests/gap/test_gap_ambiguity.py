"""What cannot be told apart, on explanations whose likeness is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap_course import SIGNALS, Sums, amount, course_of, linear, size
from hypothesis import given
from hypothesis import strategies as st

from cablesense_gap.diagnosis.ambiguity import (
    LEAST,
    NEAR_BEST,
    PARALLEL,
    ambiguity,
    imitated_share,
)
from cablesense_gap.diagnosis.belief import Belief, beliefs, bundled_calibration
from cablesense_gap.diagnosis.gauss_newton import refine
from cablesense_gap.diagnosis.problem import Course, Hypothesis
from cablesense_gap.diagnosis.search import search
from cablesense_gap.simulator import Candidate

ONE, OTHER = SIGNALS[:2]


def explained(course: Course, effects: str, change: np.ndarray, left: float = 0.1) -> Hypothesis:
    """Effects, joined by `+`, that make one change, with one number each."""
    names = tuple(effects.split("+"))
    nothing = refine(course, {}, [[]])
    assert nothing is not None
    return replace(
        nothing,
        effects=names,
        values={amount(name, "x"): 1.0 for name in names},
        deviations={amount(name, "x"): 0.1 for name in names},
        tolerances={},
        prediction=course.nominal + change,
        columns=np.array([change] * len(names)),
        held_out=course.nominal + change,
        squares=np.full(len(course.fold), left**2),
        count=np.ones(len(course.fold)),
    )


def believed(
    course: Course, changes: dict[str, np.ndarray], *probabilities: float
) -> list[Belief]:
    return [
        Belief(tuple(name.split("+")), p, explained(course, name, change))
        for (name, change), p in zip(changes.items(), probabilities, strict=True)
    ]


def plain(tolerances: dict | None = None) -> Course:
    return course_of(Sums(linear("a", ["x"]), tolerances), {amount("a", "x"): 1.0})


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
        course = plain(workshop(std, OTHER))
        one, other = explained(course, "a", ONE + 0.5 * OTHER), explained(course, "b", ONE)
        shares.append(imitated_share(course, one, other))
    assert shares[0] < 0.7
    assert shares[1] > 0.99


def test_rows_that_do_not_count_do_not_tell_apart():
    course = replace(PLAIN, used=np.arange(len(ONE)) >= 40)
    apart = ONE.copy()
    apart[:40] = 9.0
    one, other = explained(course, "a", apart), explained(course, "b", ONE)
    assert imitated_share(course, one, other) == pytest.approx(1.0, abs=2e-3)
    assert imitated_share(PLAIN, one, other) < PARALLEL


def test_a_clear_verdict_is_alone():
    found = ambiguity(PLAIN, believed(PLAIN, {"a": ONE, "b": ONE}, 0.93, 0.07))
    assert found.group == ("a",)
    assert found.reasons == ()


@pytest.mark.parametrize(("second", "group"), [(0.3, ("a", "b+c")), (0.05, ("a",))])
def test_a_rival_is_near_the_best_in_probability(second, group):
    ranked = believed(PLAIN, {"a": ONE, "b+c": OTHER}, 0.6, second)
    assert ambiguity(PLAIN, ranked).group == group
    assert (second >= max(LEAST, NEAR_BEST * 0.6)) == (len(group) == 2)


@pytest.mark.parametrize("name", ["none", "unknown"])
@pytest.mark.parametrize("leads", [True, False])
def test_ways_out_are_in_no_group(name, leads):
    out = explained(PLAIN, name, 0.0 * ONE)
    without = replace(out, effects=()) if name == "none" else None
    way_out = Belief((name,), 0.52, without)
    named = believed(PLAIN, {"a": ONE}, 0.48)
    ranked = [way_out, *named] if leads else [*named, way_out]
    assert ambiguity(PLAIN, ranked).group == ((name,) if leads else ("a",))


def test_the_reason_of_alike_effects_is_that_one_imitates_the_other():
    found = ambiguity(PLAIN, believed(PLAIN, {"a": ONE, "b": 2.0 * ONE}, 0.5, 0.4))
    assert len(found.reasons) == 1
    assert "b, with numbers of its own, imitates 100 % of the" in found.reasons[0]
    assert "shows both alike" in found.reasons[0]


def test_the_reason_of_unlike_effects_is_what_both_leave():
    found = ambiguity(PLAIN, believed(PLAIN, {"a": ONE, "b": OTHER}, 0.5, 0.4), unit="V")
    assert "so they differ; yet they leave 0.1 and 0.1 V" in found.reasons[0]


@pytest.mark.parametrize("order", [("a", "a+b"), ("a+b", "a")])
def test_the_reason_beside_a_further_effect_is_what_that_one_adds(order):
    found = ambiguity(PLAIN, believed(PLAIN, dict.fromkeys(order, ONE), 0.5, 0.4))
    assert found.group == order
    assert found.reasons[0].startswith("Beside a, b takes what is left")


def test_effects_with_one_signal_come_out_of_the_search_as_a_group():
    both = linear("left", ["x"], SIGNALS[:1]) | linear("right", ["x"], SIGNALS[:1])
    course = course_of(Sums(both), {amount("left", "x"): 2.0})
    found = ambiguity(course, beliefs(search(course), course.floor, bundled_calibration()))
    assert sorted(found.group) == ["left", "right"]
    assert "alike" in found.reasons[0]
