"""Amended arms fitted again without some of the trials."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from gap_recordings import LAB, small_recording

from cablesense_gap.arm_simulator import ArmSimulator, amended_arm
from cablesense_gap.diagnose import course_of
from cablesense_gap.diagnosis.problem import Course
from cablesense_gap.retraining import found_values, without_fold
from cablesense_gap.simulator import Term
from cablesense_sim.sensors import read_tensions_n

RECORDING = small_recording(peak_n=25.0)
MASS = Term("payload", "segment_3", "mass_kg")
ZERO = Term("cable_tolerance", "cable_2", "zero_n")
TRUE_KG = 0.5


@cache
def course() -> Course:
    simulator = ArmSimulator(LAB, RECORDING)
    ideal = simulator.predict([{MASS: TRUE_KG}])[0]
    readings = read_tensions_n(ideal, LAB.sensors, np.random.default_rng(0))
    nominal = simulator.predict([{}])[0]
    return course_of(replace(RECORDING, tensions_n=readings), simulator, nominal)


def test_found_is_what_the_nominal_arm_does_not_list_and_no_workshop_leaves():
    amended = amended_arm(LAB, {MASS: 0.45}, {ZERO: 0.02})
    assert found_values(LAB, amended) == {MASS: 0.45}
    assert found_values(amended, amended_arm(amended, {}, {ZERO: 0.03})) == {}


def test_the_refit_finds_the_number_that_is_true():
    fitted = without_fold(course(), 1, LAB, amended_arm(LAB, {MASS: 0.3}, {}))
    assert found_values(LAB, fitted) == {MASS: pytest.approx(TRUE_KG, rel=0.05)}


def test_trials_of_the_fold_have_no_say():
    held_out = course().fold[course().trial] == 1
    spoilt = course().readings + np.where(held_out, 30.0, 0.0)[:, None]
    amended = amended_arm(LAB, {MASS: 0.4}, {})
    expected = without_fold(course(), 1, LAB, amended)
    assert without_fold(replace(course(), readings=spoilt), 1, LAB, amended) == expected
    assert without_fold(replace(course(), readings=spoilt), 2, LAB, amended) != expected
