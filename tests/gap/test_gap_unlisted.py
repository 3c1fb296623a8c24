"""What is said of a gap without a name: how much, what it looks like, and what to record."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap_recordings import LAB, small_recording

from cablesense_gap.arm_simulator import ArmSimulator
from cablesense_gap.diagnose import course_of
from cablesense_gap.diagnosis.gauss_newton import refine
from cablesense_gap.unlisted import ONE_AT_A_TIME, Unlisted, describe_unlisted
from cablesense_sim.sensors import read_tensions_n

COURSE = small_recording()
NOMINAL_N = ArmSimulator(LAB, COURSE).predict([{}])[0]


def described(gap_n: np.ndarray, rows: slice = slice(None)) -> Unlisted:
    tensions_n = read_tensions_n(NOMINAL_N + gap_n, LAB.sensors, np.random.default_rng(0))
    recording = replace(COURSE, tensions_n=tensions_n).rows(rows)
    simulator = ArmSimulator(LAB, recording)
    course = course_of(recording, simulator, simulator.predict([{}])[0])
    none = refine(course, {}, [[]])
    return describe_unlisted(course, recording, [none], LAB)


@pytest.fixture(scope="module")
def bowed() -> Unlisted:
    """One cable's sensor reads by a wave of its tension that no effect of the library makes."""
    gap_n = np.zeros_like(NOMINAL_N)
    gap_n[:, 3] = 3.0 * np.sin(NOMINAL_N[:, 3])
    return described(gap_n)


def test_it_says_how_much_is_left_and_how_much_repeats(bowed):
    assert "Tolerances alone leave" in bowed.reasons[0]
    assert "A flexible model" in bowed.reasons[1]
    assert "%" in bowed.reasons[1]


def test_it_says_in_which_cable_it_is(bowed):
    assert any("cable 4" in reason for reason in bowed.reasons[2:])


def test_it_names_a_trial_to_repeat_and_how_to_vary_it(bowed):
    assert bowed.next_experiment.startswith("Repeat what shows most of it, trial")
    assert "times the noise floor" in bowed.next_experiment


def test_the_flexible_model_predicts_every_row(bowed):
    assert bowed.held_out_n.shape == NOMINAL_N.shape
    assert np.isfinite(bowed.held_out_n).all()


def test_trials_too_short_to_repeat_leave_a_general_word():
    short = np.flatnonzero(np.arange(len(COURSE.trial)) % 8 == 0)
    assert described(np.zeros_like(NOMINAL_N), short).next_experiment == ONE_AT_A_TIME
