"""Columns are what each number changes, place by place."""

from __future__ import annotations

import numpy as np
import pytest
from gap_problem import SIGNALS, TIME, Sums, fading, linear, problem_of, size
from numpy.testing import assert_allclose

from cablesense_gap.diagnosis.columns import linear_effects
from cablesense_gap.diagnosis.problem import prior_precision
from cablesense_gap.simulator import Candidate, Term
from cablesense_sim.effects.effect import Parameter


def linearised(effects):
    simulator = Sums(effects)
    return linear_effects(problem_of(simulator, {}), simulator.candidates[0])


def test_a_linear_effect_has_its_signals_as_columns():
    found = linearised(linear("gain", ["x", "y", "z"]))
    assert [effect.place for effect in found] == ["x", "y", "z"]
    for effect, signal in zip(found, SIGNALS, strict=False):
        assert_allclose(effect.columns, signal[None], atol=1e-12)
        assert effect.terms == (Term("gain", effect.place, "amount"),)
        assert_allclose(effect.start, 0.0)


def test_a_column_is_the_change_of_a_typical_size():
    candidate = Candidate("gain", ("x",), (size("amount", typical=0.2),))
    (effect,) = linearised({candidate: lambda _, numbers: numbers["amount"] * SIGNALS[0]})
    assert_allclose(effect.columns[0], 0.2 * SIGNALS[0])


@pytest.mark.parametrize("history_dependent", [False, True])
def test_every_starting_shape_has_columns_of_its_own(history_dependent):
    ((candidate, change),) = fading("fading", ["x", "y"]).items()
    parameters = candidate.parameters[0], Parameter(
        "rate", "1", 0.1, 50.0, 3.0, "rate", 3.0, "shape", starts=(1.0, 8.0)
    )  # fmt: skip
    found = linearised({Candidate("fading", ("x", "y"), parameters, history_dependent): change})
    expected = [(rate, signal) for rate in (1.0, 8.0) for signal in SIGNALS[6:]]
    for effect, (rate, signal) in zip(found, expected, strict=True):
        assert_allclose(effect.columns, [np.exp(-rate * TIME)[:, None] * signal], atol=1e-12)
        assert_allclose(effect.start, [0.0, np.log(rate)])


def test_a_shape_that_may_be_zero_is_linear_too():
    shift = Parameter("shift", "1", -2.0, 2.0, 0.5, "shift", 0.0, "shape")
    candidate = Candidate("moved", ("x",), (size("amount", 2.0), shift))
    (effect,) = linearised(
        {candidate: lambda _, n: n["amount"] * (SIGNALS[0] + n["shift"] * SIGNALS[1])}
    )
    assert [term.parameter for term in effect.varied] == ["amount", "shift"]
    assert_allclose(effect.columns[0], 2.0 * SIGNALS[0])
    assert_allclose(effect.columns[1], 2.0 * 0.5 * SIGNALS[1], atol=1e-12)


def test_two_sizes_have_a_column_each():
    candidate = Candidate("tilt", ("x",), (size("roll", 0.1), size("pitch", 0.3)))
    (effect,) = linearised(
        {candidate: lambda _, n: n["roll"] * SIGNALS[0] + n["pitch"] * SIGNALS[1]}
    )
    assert_allclose(effect.columns, [0.1 * SIGNALS[0], 0.3 * SIGNALS[1]])
    assert_allclose(effect.precision, [prior_precision(p) for p in candidate.parameters])


def test_places_that_cannot_be_simulated_are_not_offered():
    candidate = Candidate("gain", ("x", "broken", "z"), (size("amount"),))

    def change(place, numbers):
        return numbers["amount"] * (np.nan if place == "broken" else SIGNALS[0])

    assert [effect.place for effect in linearised({candidate: change})] == ["x", "z"]
