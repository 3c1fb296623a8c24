"""A gap without a name: its pattern in sentences that fit what was planted, and what to record."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cablesense_gap.arm_simulator import ArmSimulator
from cablesense_gap.arm_system import ArmSystem
from cablesense_gap.diagnosis.discrepancy import FlexibleModel
from cablesense_gap.diagnosis.fitting import refine
from cablesense_gap.residuals import load_branch
from cablesense_gap.system import problem_of
from cablesense_gap.unlisted import repeat_largest_trial, residual_features, residual_patterns
from cablesense_recording.recording import Recording
from cablesense_sim.replay import read_tensions_n
from tests.helpers.gap_recordings import LAB, PLACES_M, placed_recording, small_recording

SMALL = small_recording()
FLOOR_N = 0.1
ROWS = len(SMALL)
LOAD = np.linalg.norm(SMALL.load_n, axis=1)
ALL = np.ones(12)
CABLES = np.eye(12)


@pytest.mark.slow
def test_reasons_experiment_and_prediction_fit_the_gap():
    """One cable's sensor reads by a wave of its tension, as no effect of the library does."""
    nominal_n = ArmSimulator(LAB, SMALL).predict([{}])[0]
    wave_n = 3.0 * np.sin(nominal_n) * CABLES[3]
    read_n = read_tensions_n(nominal_n + wave_n, LAB.sensors, np.random.default_rng(0))
    recording = replace(SMALL, tensions_n=read_n)
    system = ArmSystem(LAB, recording)
    problem = problem_of(system)
    without_effects = refine(problem, {}, [[]])
    reasons, experiment, held_out_n = system.unlisted(problem, read_n - without_effects.held_out)
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
