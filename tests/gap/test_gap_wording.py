"""The verdict in words, and the numbers in it."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from verdict_cases import gap_of, verdict_of

from cablesense_gap.report.style import listed, newtons, percent, with_interval
from cablesense_gap.report.text import (
    ambiguity,
    effect_places,
    effect_words,
    headline,
    place_words,
    regime_words,
    shrinkage,
)
from cablesense_gap.verdict import Estimate, Where
from cablesense_sim.effects.registry import known_effects

ONE = Estimate(value=1.0, unit="1", ci95=(0.9, 1.1))


def test_two_effects_are_named_each_with_its_places():
    verdict = verdict_of(
        "payload+sensor_gain",
        0.6,
        cables=("cable_3", "cable_5"),
        segments=("segment_2",),
        parameters={
            "payload.segment_2.mass_kg": ONE,
            "sensor_gain.cable_5.gain": ONE,
            "sensor_gain.cable_3.gain": ONE,
        },
    )
    assert headline(verdict) == (
        "The gap probably comes from mass that nobody modelled, on segment 2, and from a wrong "
        "scale of tension sensors, at cables 3 and 5 (60 % sure)."
    )


def test_places_come_from_the_parameters_and_else_from_the_verdict():
    crosstalk = verdict_of(
        "sensor_crosstalk", parameters={"sensor_crosstalk.cable_2_into_cable_5.share": ONE}
    )
    assert effect_places(crosstalk, "sensor_crosstalk") == ("cable_2", "cable_5")
    everywhere = verdict_of("sensor_lag", parameters={"sensor_lag.arm.time_constant_s": ONE})
    assert effect_places(everywhere, "sensor_lag") == ()
    short = verdict_of("payload", segments=("segment_1",), parameters={"payload.mass_kg": ONE})
    assert effect_places(short, "payload") == ("segment_1",)


def test_an_effect_of_a_users_own_keeps_its_name():
    assert headline(verdict_of("hose_drag", 0.95)) == "The gap comes from hose drag (95 % sure)."


def test_every_effect_of_the_library_has_words_and_advice():
    for name, effect in known_effects().items():
        if not effect.tolerance:
            assert effect_words(name).look, name


def test_what_cannot_be_told_apart_is_said():
    assert ambiguity(verdict_of("payload", ambiguity_group=("payload",))) == ""
    verdict = verdict_of("payload", ambiguity_group=("base_tilt+payload", "none", "payload"))
    assert ambiguity(verdict) == (
        "This recording cannot tell it from base tilt + payload or none."
    )


@pytest.mark.parametrize(
    ("effects", "after_n", "words"),
    [
        ("payload", 0.2, "shrinks the gap from 3.00 N to 0.20 N on trials"),
        ("payload", 3.2, "does not shrink"),
        ("unknown", 0.2, "flexible correction"),
        ("unknown", 3.0, "No effect of the library shrinks it"),
        ("none", 3.0, "noise and the sensors' step alone make 0.10 N"),
    ],
)
def test_how_far_the_gap_shrinks_is_said(effects, after_n, words):
    assert words in shrinkage(verdict_of(effects, gap=gap_of(3.0, after_n)))


def test_regimes_are_said():
    verdict = verdict_of("payload")
    assert regime_words(verdict) == ""
    for regimes, words in (
        (("everywhere alike",), "alike whatever the arm does"),
        (("moving", "bent poses"), "here: moving, bent poses."),
    ):
        assert words in regime_words(verdict.model_copy(update={"where": Where(regimes=regimes)}))


def test_places_are_gathered_by_kind():
    assert place_words(("cable_12", "cable_3", "joint_1")) == "at cables 3 and 12, in joint 1"
    assert listed(["a", "b", "c"]) == "a, b and c"
    assert listed([]) == ""


@given(st.floats(0.0, 1.0))
def test_a_percentage_never_claims_certainty_that_is_not_there(share):
    words = percent(share)
    assert (words == "100 %") == (share == 1.0)
    assert (words == "0 %") == (share == 0.0)


@pytest.mark.parametrize(
    ("value", "low", "high", "words"),
    [
        (0.49031, 0.4811, 0.4998, ("0.490", "0.481 to 0.500")),
        (123.4, 110.0, 140.0, ("123", "110 to 140")),
        (2.5e-6, 2.0e-6, 3.0e-6, ("0.0000025", "0.0000020 to 0.0000030")),
        (0.5, 0.5, 0.5, ("0.5000", "0.5000 to 0.5000")),
        (0.0, 0.0, 0.0, ("0.000", "0.000 to 0.000")),
    ],
)
def test_numbers_have_the_digits_that_their_interval_leaves(value, low, high, words):
    assert with_interval(Estimate(value=value, unit="1", ci95=(low, high))) == words


def test_newtons_have_the_digits_of_a_sensor():
    assert [newtons(x) for x in (0.0749, 9.994, 12.34)] == ["0.07 N", "9.99 N", "12.3 N"]
