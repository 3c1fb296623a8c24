"""Columns of a first look are what each number changes, place by place."""

from __future__ import annotations

import numpy as np
import pytest
from gap_course import SIGNALS, TIME, Sums, course_of, fading, linear, size
from numpy.testing import assert_allclose

from cablesense_gap.diagnosis.places import blocks
from cablesense_gap.diagnosis.problem import prior_precision, to_scaled
from cablesense_gap.simulator import Candidate, Term
from cablesense_sim.effects.effect import Parameter


def looked_at(effects):
    simulator = Sums(effects)
    return blocks(course_of(simulator, {}), simulator.candidates[0])


def test_a_linear_effect_has_its_signals_as_columns():
    (found,) = looked_at(linear("gain", ["x", "y", "z"]))
    assert [block.place for block in found] == ["x", "y", "z"]
    for block, signal in zip(found, SIGNALS, strict=False):
        assert_allclose(block.columns, signal[None], atol=1e-12)
        assert block.terms == (Term("gain", block.place, "amount"),)
        assert_allclose(block.start, 0.0)


def test_a_column_is_the_change_of_a_typical_size():
    candidate = Candidate("gain", ("x",), (size("amount", typical=0.2),))
    ((block,),) = looked_at({candidate: lambda _, numbers: numbers["amount"] * SIGNALS[0]})
    assert_allclose(block.columns[0], 0.2 * SIGNALS[0])


def test_every_starting_shape_has_blocks_of_its_own():
    effect = fading("fading", ["x", "y"])
    (candidate,) = effect
    parameters = candidate.parameters[0], Parameter(
        "rate", "1", 0.1, 50.0, 3.0, "rate", 3.0, "shape", starts=(1.0, 8.0)
    )  # fmt: skip
    effect = {Candidate("fading", ("x", "y"), parameters): effect[candidate]}
    found = looked_at(effect)
    assert len(found) == 2
    for some, rate in zip(found, (1.0, 8.0), strict=True):
        for block, signal in zip(some, SIGNALS[6:], strict=True):
            assert_allclose(block.columns, [np.exp(-rate * TIME)[:, None] * signal])
            assert_allclose(block.start, [0.0, np.log(rate)])
            assert block.probed == ("amount",)


@pytest.mark.parametrize("remembers", [False, True])
def test_side_by_side_is_as_one_by_one(remembers):
    (found,) = looked_at(fading("fading", ["x", "y"], remembers=remembers))
    for block, signal in zip(found, SIGNALS[6:], strict=True):
        assert_allclose(block.columns, [np.exp(-2.0 * TIME)[:, None] * signal], atol=1e-12)


def test_what_remembers_is_simulated_at_one_go():
    simulator = Sums(fading("fading", ["x", "y"], remembers=True))
    course = course_of(simulator, {})
    simulator.asked.clear()
    blocks(course, simulator.candidates[0])
    assert len(simulator.asked) == 2
    assert len({frozenset(variant) for variant in simulator.asked}) == 1


def test_a_shape_that_may_be_zero_is_looked_at_beside_a_size():
    shift = Parameter("shift", "1", -2.0, 2.0, 0.5, "shift", 0.0, "shape")
    candidate = Candidate("moved", ("x",), (size("amount", 2.0), shift))
    ((block,),) = looked_at(
        {candidate: lambda _, n: n["amount"] * (SIGNALS[0] + n["shift"] * SIGNALS[1])}
    )
    assert block.probed == ("amount", "shift")
    assert_allclose(block.columns[0], 2.0 * SIGNALS[0])
    assert_allclose(block.columns[1], 2.0 * 0.5 * SIGNALS[1], atol=1e-12)


def test_two_sizes_are_looked_at_apart():
    candidate = Candidate("tilt", ("x",), (size("roll", 0.1), size("pitch", 0.3)))
    ((block,),) = looked_at(
        {candidate: lambda _, n: n["roll"] * SIGNALS[0] + n["pitch"] * SIGNALS[1]}
    )
    assert_allclose(block.columns, [0.1 * SIGNALS[0], 0.3 * SIGNALS[1]])
    expected = [prior_precision(p) for p in candidate.parameters]
    assert_allclose(block.precision, expected)


def test_places_that_cannot_be_simulated_are_left_out():
    candidate = Candidate("gain", ("x", "broken", "z"), (size("amount"),))

    def change(place, numbers):
        return numbers["amount"] * (np.nan if place == "broken" else SIGNALS[0])

    (found,) = looked_at({candidate: change})
    assert [block.place for block in found] == ["x", "z"]


def test_a_start_is_in_scaled_numbers():
    effect = fading("fading", ["x"])
    ((block,),) = looked_at(effect)
    rate = next(iter(effect)).parameters[1]
    assert block.start[1] == to_scaled(rate, 2.0)
