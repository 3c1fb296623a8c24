"""Places and numbers as the verdict names them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap_course import CHANNELS, TRIAL, explanation, rate, size

from cablesense_gap.diagnose import NEGLIGIBLE, estimates, foremost, where
from cablesense_gap.simulator import Candidate, Term

LEAK = Candidate("leak", ("a", "b", "c"), (size("amount"), rate()))
HEAVY = Candidate("heavy", ("a",), (size("amount"),))
SHAPE = (len(TRIAL), CHANNELS)


def amount(place: str, effect: str = "leak") -> Term:
    return Term(effect, place, "amount")


def changing(by_term: dict[Term, float]):
    """A hypothesis whose terms each change the readings by so much (root mean square)."""
    values = dict.fromkeys(by_term, 1.0)
    return replace(
        explanation(*sorted({term.effect for term in by_term})),
        values=values,
        deviations=dict.fromkeys(by_term, 0.2),
        columns=np.array([np.full(SHAPE, change) for change in by_term.values()]),
    )


def test_places_that_change_next_to_nothing_are_left_out():
    found = changing({amount("a"): 1.0, amount("b"): 2.0 * NEGLIGIBLE, amount("c"): 0.01})
    assert list(foremost(found, (LEAK,))) == [amount("a"), amount("b")]


def test_a_place_keeps_its_shapes_and_loses_them_with_its_size():
    rates = Term("leak", "a", "rate"), Term("leak", "b", "rate")
    found = changing({amount("a"): 1.0, rates[0]: 0.0, amount("b"): 0.01, rates[1]: 5.0})
    assert list(foremost(found, (LEAK,))) == [amount("a"), rates[0]]


def test_each_effect_is_measured_by_its_own_foremost_place():
    """A second effect may be far smaller than the first: that is for the belief to say."""
    found = changing({amount("a"): 100.0, amount("a", "heavy"): 0.5})
    assert set(foremost(found, (LEAK, HEAVY))) == set(found.values)


def test_tolerances_alone_name_nothing():
    assert foremost(changing({}), (LEAK,)) == {}


def test_places_go_by_kind_and_number():
    terms = [
        Term("x", place, "y") for place in ("cable_10", "cable_2", "segment_3", "joint_1", "arm")
    ]
    found = where(dict.fromkeys(terms, 1.0), ("moving",))
    assert found.cables == ("cable_2", "cable_10")
    assert (found.segments, found.joints) == (("segment_3",), ("joint_1",))
    assert found.regimes == ("moving",)


def test_of_a_leak_the_channel_is_named_that_it_comes_from():
    leak = Term("sensor_crosstalk", "cable_7_into_cable_2", "share")
    assert where({leak: 0.1}, ()).cables == ("cable_7",)


def test_numbers_have_units_and_intervals_and_the_place_where_there_are_several():
    values = {amount("a", "heavy"): 2.0, amount("a"): 1.0, amount("b"): -1.0}
    found = estimates(values, dict.fromkeys(values, 0.5), (LEAK, HEAVY))
    assert list(found) == ["heavy.a.amount", "leak.a.amount", "leak.b.amount"]
    assert found["heavy.a.amount"].ci95 == pytest.approx((1.5, 2.5))
    assert found["leak.b.amount"].unit == "1"
