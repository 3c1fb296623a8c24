"""Effects that an arm file lists already, on a new recording: which stand, with which numbers."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from gap_recordings import LAB, small_recording

from cablesense_gap.amended_arm import (
    amended_arm,
    judged_earlier,
    listed_values,
    without_effects,
)
from cablesense_gap.arm_simulator import ArmSimulator
from cablesense_gap.arm_system import ArmSystem
from cablesense_gap.pipeline import problem_of
from cablesense_gap.report.text import earlier_sentence
from cablesense_gap.simulator import Term
from cablesense_gap.verdict import Earlier, FittedNumber
from cablesense_sim.arm import Arm
from cablesense_sim.replay import read_tensions_n

PROTOCOL = small_recording(peak_n=25.0)
MASS = Term("payload", "segment_3", "mass_kg")
OFFSET = Term("contact_offset", "segment_4", "offset_m")
GAIN = Term("sensor_gain", "cable_2", "gain")
ZERO = Term("cable_tolerance", "cable_5", "zero_n")
LISTED = amended_arm(LAB, {MASS: 0.4, OFFSET: 0.02, GAIN: 0.1}, {ZERO: 0.04})


@cache
def found() -> tuple[Arm, tuple[Earlier, ...]]:
    """On the arm of today: more payload, the same offset, and the sensor was put right."""
    true = ArmSimulator(LAB, PROTOCOL).predict([{MASS: 0.55, OFFSET: 0.02, ZERO: 0.04}])[0]
    read = read_tensions_n(true, LAB.sensors, np.random.default_rng(0))
    recording = replace(PROTOCOL, tensions_n=read)
    return judged_earlier(problem_of(ArmSystem(without_effects(LISTED), recording)), LISTED)


def test_tolerances_are_no_finding():
    assert listed_values(LISTED) == {MASS: 0.4, OFFSET: 0.02, GAIN: 0.1}
    assert [e.effect for e in without_effects(LISTED).effects] == ["cable_tolerance"]


@pytest.mark.slow  # fits with the simulator
def test_each_effect_is_said_to_stand_to_have_changed_or_not_to_be_needed():
    outcomes = {each.effect: each.outcome for each in found()[1]}
    assert outcomes == {
        "contact_offset": "stands",
        "payload": "changed",
        "sensor_gain": "not needed",
    }
    payload = next(each for each in found()[1] if each.effect == "payload")
    assert (payload.places, payload.was) == (("segment_3",), {"segment_3.mass_kg": 0.4})
    assert payload.now["segment_3.mass_kg"].value == pytest.approx(0.55, rel=0.05)
    text = earlier_sentence(payload)
    assert "on segment 3" in text
    assert "(was 0.4)" in text


def test_a_number_without_a_unit_is_said_without_one():
    gain = FittedNumber(value=1.04, unit="1", ci95=(1.03, 1.05))
    changed = Earlier(
        effect="sensor_gain", places=("cable_3",), outcome="changed",
        was={"cable_3.gain": 1.02}, now={"cable_3.gain": gain},
    )  # fmt: skip
    assert earlier_sentence(changed).endswith(": cable_3.gain 1.04 (was 1.02).")


@pytest.mark.slow  # fits with the simulator
def test_the_diagnosis_goes_on_from_what_stands_with_its_new_numbers():
    values = listed_values(found()[0])
    assert set(values) == {MASS, OFFSET}
    assert values[MASS] == pytest.approx(0.55, rel=0.05)
