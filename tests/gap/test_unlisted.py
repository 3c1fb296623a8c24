"""A gap without a name: its features, its pattern, and what to record."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap_recordings import LAB, small_recording

from cablesense_gap.arm_simulator import ArmSimulator
from cablesense_gap.arm_system import ArmSystem
from cablesense_gap.diagnosis.gauss_newton import refine
from cablesense_gap.pipeline import problem_of
from cablesense_gap.unlisted import (
    ONE_AT_A_TIME,
    describe_unlisted,
    repeat_largest_trial,
    residual_features,
)
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import held_lengths_m
from cablesense_sim.replay import read_tensions_n

RECORDING = small_recording()
NOMINAL_N = ArmSimulator(LAB, RECORDING).predict([{}])[0]


def described(gap_n: np.ndarray, rows: slice = slice(None)):
    tensions_n = read_tensions_n(NOMINAL_N + gap_n, LAB.sensors, np.random.default_rng(0))
    recording = replace(RECORDING, tensions_n=tensions_n).rows(rows)
    problem = problem_of(ArmSystem(LAB, recording))
    none = refine(problem, {}, [[]])
    return describe_unlisted(problem, recording.tensions_n - none.held_out, recording, LAB)


@pytest.fixture(scope="module")
def bowed():
    """One cable's sensor reads by a wave of its tension that no effect of the library makes."""
    gap_n = np.zeros_like(NOMINAL_N)
    gap_n[:, 3] = 3.0 * np.sin(NOMINAL_N[:, 3])
    return described(gap_n)


@pytest.mark.slow
def test_reasons_experiment_and_prediction_fit_the_gap(bowed):
    reasons, experiment, held_out_n = bowed
    assert "A flexible model" in reasons[0]
    assert "%" in reasons[0]
    assert any("cable 4" in reason for reason in reasons[1:])
    assert experiment.startswith("Repeat what shows most of it, trial")
    assert "times the noise floor" in experiment
    assert held_out_n.shape == NOMINAL_N.shape
    assert np.isfinite(held_out_n).all()


def test_trials_too_short_to_repeat_leave_a_general_word():
    short = np.flatnonzero(np.arange(len(RECORDING.trial)) % 8 == 0)
    assert described(np.zeros_like(NOMINAL_N), short)[1] == ONE_AT_A_TIME


SMALL = small_recording()
TENSION = 40.0 + np.outer(np.linalg.norm(SMALL.load_n, axis=1), np.linspace(-0.5, 0.5, 12))
FEATURES = residual_features(SMALL, TENSION, LAB)


def column(name: str, which: int = 0) -> np.ndarray:
    at = [k for k, known in enumerate(FEATURES.names) if known == name]
    return FEATURES.values[:, at[which]]


def test_every_row_has_every_feature():
    assert FEATURES.values.shape == (len(SMALL), len(FEATURES.names))
    assert len(FEATURES.groups) == len(FEATURES.names)
    assert np.isfinite(FEATURES.values).all()


def test_loads_are_by_segment_and_axis():
    third = SMALL.load_segment == 3
    along = column("load on segment_3 along z")
    np.testing.assert_array_equal(along[third], SMALL.load_n[third, 2])
    assert not along[~third].any()


def test_motion_is_the_sign_of_the_lengths_change():
    length = held_lengths_m(mechanism_of(LAB), SMALL.command_rad)[:, 5]
    sweep = np.flatnonzero(SMALL.trial == SMALL.trial.max())[1:]
    np.testing.assert_array_equal(
        column("motion of cable_6")[sweep], np.sign(np.diff(length))[sweep - 1]
    )


def test_nothing_moves_between_trials_and_under_a_load():
    assert not column("motion of cable_6")[SMALL.trial < SMALL.trial.max()].any()


@pytest.mark.parametrize("which", [0, 1])
def test_turning_points_tell_loading_from_unloading(which):
    """At one load, before and after its peak, a play is on opposite sides."""
    rows = np.flatnonzero(SMALL.trial == 1)
    lag = column("turning points of cable_12", which)[rows]
    assert np.abs(lag).max() <= 1.0
    assert lag[10] == pytest.approx(1.0)
    assert lag[26] < -0.5


def test_waiting_begins_anew_with_each_change():
    rows = np.flatnonzero(SMALL.trial == 2)
    waited = column("time since the last change")[rows]
    np.testing.assert_allclose(waited[4:8], waited[8:12])
    assert (np.diff(waited[4:8]) < 0.0).all()


def shown_in(trial: int):
    large = np.where((SMALL.trial == trial)[:, None], 2.0, 0.2)
    return repeat_largest_trial(SMALL, np.broadcast_to(large, SMALL.tensions_n.shape), 0.1)


def test_a_load_is_told_with_segment_side_size_and_pose():
    found = shown_in(2)
    assert "trial 2: load segment 2 down up to 40 N, arm straight. There 2 N are left" in found
    assert "20 times the noise floor" in found
    assert "half as far" in found


def test_a_bent_pose_is_said():
    assert "arm bent as then (up to 5.7 degrees)" in shown_in(7)


def test_a_sweep_is_told_with_its_joint():
    found = shown_in(9)
    assert "move joint 2 by 14 degrees in all." in found
    assert "one joint at a time" in found


def test_a_rest_is_to_be_left_longer():
    found = shown_in(0)
    assert "leave the arm alone, arm straight." in found
    assert "ten minutes" in found


def test_another_direction_is_told_by_numbers():
    turned = SMALL.load_n[:, [2, 1, 0]]
    sideways = type(SMALL)(**{**vars(SMALL), "load_n": turned})
    found = repeat_largest_trial(
        sideways, np.where((SMALL.trial == 1)[:, None], 2.0, 0.1) * np.ones(12), 0.1
    )
    assert "along (-1.00, 0.00, 0.00) of the base frame" in found


def test_trials_of_a_few_rows_do_not_count():
    short = SMALL.rows(np.r_[0:30, 60:65])
    loud = np.where((short.trial == short.trial.max())[:, None], 9.0, 0.1) * np.ones(12)
    assert "trial 0" in repeat_largest_trial(short, loud, 0.1)
    assert repeat_largest_trial(SMALL.rows(slice(0, 5)), np.ones((5, 12)), 0.1) == ONE_AT_A_TIME
