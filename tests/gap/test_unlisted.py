"""A gap without a name: its pattern in sentences that fit what was planted, and what to record."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap_recordings import LAB, PLACES_M, placed_recording, small_recording

from cablesense_gap.arm_simulator import ArmSimulator
from cablesense_gap.arm_system import ArmSystem
from cablesense_gap.diagnosis.discrepancy import FlexibleModel
from cablesense_gap.diagnosis.fitting import refine
from cablesense_gap.pipeline import problem_of
from cablesense_gap.recordings.recording import Recording
from cablesense_gap.residuals import load_branch
from cablesense_gap.unlisted import (
    repeat_largest_trial,
    residual_features,
    residual_patterns,
)
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import held_lengths_m
from cablesense_sim.replay import read_tensions_n

SMALL = small_recording()
FLOOR_N = 0.1
ROWS = len(SMALL)
LOAD = np.linalg.norm(SMALL.load_n, axis=1)
ALL, CABLES = np.ones(12), np.eye(12)


@pytest.mark.slow
def test_reasons_experiment_and_prediction_fit_the_gap():
    """One cable's sensor reads by a wave of its tension, as no effect of the library does."""
    nominal_n = ArmSimulator(LAB, SMALL).predict([{}])[0]
    wave_n = 3.0 * np.sin(nominal_n) * CABLES[3]
    read_n = read_tensions_n(nominal_n + wave_n, LAB.sensors, np.random.default_rng(0))
    recording = replace(SMALL, tensions_n=read_n)
    system = ArmSystem(LAB, recording)
    problem = problem_of(system)
    none = refine(problem, {}, [[]])
    reasons, experiment, held_out_n = system.unlisted(problem, read_n - none.held_out)
    assert reasons[0].startswith("A flexible model of commands")
    assert any("cable 4" in reason for reason in reasons[1:])
    assert experiment.startswith("Repeat trial")
    assert held_out_n.shape == nominal_n.shape
    assert np.isfinite(held_out_n).all()


def model(explained: float = 0.8, **alone: float) -> FlexibleModel:
    return FlexibleModel(np.zeros((ROWS, 12)), explained, alone, "size of the load")


def said(planted, found=None, recording: Recording = SMALL) -> str:
    noise = np.random.default_rng(9).normal(0.0, FLOOR_N, recording.tensions_n.shape)
    return " ".join(residual_patterns(recording, noise + planted, found or model(), LAB, FLOOR_N))


def test_noise_has_no_pattern():
    assert said(np.zeros(12)) == ""


BENDING = np.cos(2.0 * np.pi * np.tile([0, 1, 2], 4) / 3.0)
BRANCH = load_branch(SMALL)
LOOP = np.select([BRANCH == 1, BRANCH == 2], [0.5, -0.5])[:, None] * ALL
STEP = np.outer(np.arange(ROWS) >= 150, 1.3 * CABLES[7])
JUMPS = np.zeros((ROWS, 12))
JUMPS[[30, 66, 102], 4] = 9.0


@pytest.mark.parametrize(
    ("planted", "words"),
    [
        (
            CABLES[2] - 0.8 * CABLES[10],
            "94% of its mean square is in cable 3 (1 N RMS) and cable 11 (0.8 N RMS).",
        ),
        (ALL, "It is in all cables"),
        (ALL, "change alike"),
        (BENDING, "against each other"),
        (0.03 * np.outer(LOAD, ALL), "grows with the load: "),
        (0.03 * np.outer(LOAD, ALL), "N RMS for loads above 27 N"),
        # 1 N at three levels, and nothing without a load
        (LOOP, "Loading and unloading differ by 0.87 N RMS"),
        (STEP, "It changes once and stays: cable 8 by +1.3 N at 30 s."),
        (JUMPS, "It jumps while nothing moves: 6 times in cable 5 (by 9 N)."),
    ],
)
def test_the_pattern_of_a_planted_residual_is_described(planted, words):
    assert words in said(planted)


MOVING = SMALL.trial == SMALL.trial.max()
WILD = np.random.default_rng(1).normal(0.0, 5.0, (ROWS, 12)) * MOVING[:, None]


def late(keeps: float) -> np.ndarray:
    """A residual that follows each change of the load and fades."""
    found = np.zeros(ROWS)
    for row in range(1, ROWS):
        found[row] = keeps * (found[row - 1] + LOAD[row] - LOAD[row - 1])
    return -np.outer(found, ALL)


@pytest.mark.parametrize(
    ("planted", "not_said"),
    [
        (0.03 * np.outer(LOAD, ALL), "Loading and unloading"),
        (0.1 * np.outer(LOAD, ALL), "changes once"),
        (np.outer(np.arange(ROWS) >= ROWS - 5, 2.0 * CABLES[7]), "changes once"),
        (np.outer(LOAD, ALL) + WILD, "jumps"),
        *[(late(keeps), "jumps") for keeps in (0.2, 0.5, 0.8)],
    ],
)
def test_another_pattern_is_not_described(planted, not_said):
    text = said(planted)
    assert text
    assert not_said not in text


@pytest.mark.parametrize(
    ("group", "words"),
    [
        ("pose", "depends on the commanded pose, most clearly on size of the load: a flexible"),
        ("history", "It depends on the last reversals of the tensions"),
        ("gears", "It depends on gears"),
    ],
)
def test_the_group_of_features_that_predicts_most_is_named(group, words):
    text = said(ALL, model(alone_other=0.1, **{group: 0.7}))
    assert words in text
    assert "predicts 70% of it" in text


ROWS_SWEEP = 500
rng = np.random.default_rng(2)
TIME_S = np.arange(ROWS_SWEEP) / 5.0
COMMAND = 0.18 * np.sin(np.outer(TIME_S, rng.uniform(0.15, 0.5, 8)) + rng.uniform(0.0, 6.0, 8))
LENGTH_M = held_lengths_m(mechanism_of(LAB), COMMAND)
MIXED = rng.normal(size=12)
SMOOTH = 30.0 * COMMAND[:, 0] + 200.0 * COMMAND[:, 1] * COMMAND[:, 4]


def sweep() -> Recording:
    return Recording(
        name="sweep",
        time_s=TIME_S,
        trial=np.zeros(ROWS_SWEEP, dtype=np.int64),
        command_rad=COMMAND,
        load_segment=np.zeros(ROWS_SWEEP, dtype=np.int64),
        load_n=np.zeros((ROWS_SWEEP, 3)),
        tensions_n=np.full((ROWS_SWEEP, 12), 50.0),
    )


@pytest.mark.parametrize(
    ("planted", "words"),
    [
        (np.outer(np.sin(2.0 * np.pi * COMMAND[:, 3] / 0.07), MIXED), "4 degrees of joint 2 yaw"),
        (
            np.outer(np.sin(2.0 * np.pi * LENGTH_M[:, 6] / 0.004), CABLES[6]),
            "4 mm of cable, most in cable 7",
        ),
    ],
    ids=["a joint's detents", "one screw"],
)
def test_a_period_is_found(planted, words):
    number = float(words.split()[0])
    found = said(planted, recording=sweep()).partition("It repeats every ")[2]
    assert found.partition(" ")[2].startswith(words.partition(" ")[2])
    assert float(found.split()[0]) == pytest.approx(number, rel=0.08)


@pytest.mark.parametrize(
    ("planted", "recording"),
    [
        (np.outer(SMOOTH, MIXED), sweep()),
        (rng.normal(size=(ROWS_SWEEP, 12)), sweep()),
    ],
    ids=["smooth in the pose", "scatter"],
)
def test_other_residuals_have_no_period(planted, recording):
    assert "repeats" not in said(planted, recording=recording)


TENSION = 40.0 + np.outer(LOAD, np.linspace(-0.5, 0.5, 12))
FEATURES = residual_features(SMALL, TENSION, LAB)


def test_loads_are_by_segment_and_axis():
    third = SMALL.load_segment == 3
    along = FEATURES["load"]["load on segment_3 along z"]
    np.testing.assert_array_equal(along[third], SMALL.load_n[third, 2])
    assert not along[~third].any()


@pytest.mark.parametrize("size", ["", "large "])
def test_reversals_distinguish_loading_from_unloading(size):
    """At one load, before and after its peak, a play is on opposite sides."""
    rows = np.flatnonzero(SMALL.trial == 1)
    lag = FEATURES["history"][f"{size}reversals of cable_12"][rows]
    assert np.abs(lag).max() <= 1.0
    assert lag[10] == pytest.approx(1.0)
    assert lag[26] < -0.5


@pytest.mark.parametrize(
    ("trial", "words"),
    [
        (2, "Repeat trial 2, which has the largest residual: load segment 2 down up to 40 N, arm"),
        (2, "It leaves 2 N, 20 times the noise floor. Then load it to half the force"),
        (7, "arm bent as in the recording (up to 5.7 degrees)"),
        (9, "move joint 2 over 14 degrees."),
        (0, "leave the arm at rest, arm straight."),
    ],
)
def test_the_trial_with_the_largest_residual_is_repeated_and_varied(trial, words):
    large = np.where((SMALL.trial == trial)[:, None], 2.0, 0.2) * ALL
    assert words in repeat_largest_trial(SMALL, large, 0.1)


def test_the_place_of_a_load_is_part_of_its_row():
    """There is a feature of place and force, and a trial that is repeated there."""
    placed = placed_recording()
    features = residual_features(placed, placed.tensions_n, LAB)
    far = features["load"]["place of the load on segment_2 along z"]
    moment = (PLACES_M[placed.trial % 3] - 0.065) * np.where(placed.load_segment == 2, -1.0, 0.0)
    np.testing.assert_allclose(far, moment * np.abs(placed.load_n[:, 2]), atol=1e-12)
    large = np.where((placed.trial == 2)[:, None], 2.0, 0.2) * ALL
    text = repeat_largest_trial(placed, large, 0.1)
    assert "load segment 2, 115 mm from its joint, down up to 40 N" in text
