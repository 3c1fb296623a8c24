"""Patterns of a residual: the sentence fits what was planted, and no other is given."""

from __future__ import annotations

import numpy as np
import pytest
from gap_recordings import LAB, small_recording

from cablesense_gap.diagnosis.discrepancy import Discrepancy
from cablesense_gap.recordings.recording import Recording
from cablesense_gap.residual_patterns import jumps, periodic, residual_patterns, steps
from cablesense_gap.residuals import load_branch
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import held_lengths_m

SMALL = small_recording()
FLOOR_N = 0.1
ROWS = len(SMALL)
LOAD = np.linalg.norm(SMALL.load_n, axis=1)


def model(explained: float = 0.8, **alone: float) -> Discrepancy:
    return Discrepancy(
        held_out=np.zeros((ROWS, 12)),
        explained_share=explained,
        by_channel=(explained,) * 12,
        alone=alone,
        foremost=("size of the load", "time"),
    )


def said(planted: np.ndarray, found: Discrepancy | None = None) -> str:
    noise = np.random.default_rng(9).normal(0.0, FLOOR_N, (ROWS, 12))
    return " ".join(residual_patterns(SMALL, noise + planted, found or model(), LAB, FLOOR_N))


def test_of_noise_nothing_is_said():
    assert said(np.zeros(12)) == ""


def test_the_cables_that_hold_most_are_named():
    text = said(np.eye(12)[2] - 0.8 * np.eye(12)[10])
    assert text.startswith("94% of its square is in cable 3 (1 N RMS) and cable 11 (0.8 N RMS).")


def test_what_is_everywhere_is_in_all_cables():
    assert said(np.ones(12)).startswith("It is in all cables")


def test_cables_of_a_set_that_change_alike_or_against_each_other():
    assert "change alike" in said(np.ones(12))
    bending = np.cos(2.0 * np.pi * np.tile([0, 1, 2], 4) / 3.0)
    assert "against each other" in said(bending)


def test_the_load_it_grows_with():
    text = said(0.03 * LOAD[:, None] * np.ones(12))
    assert "grows with the load: " in text
    assert "N RMS for loads above 27 N" in text


def test_a_loop_between_loading_and_unloading():
    branch = load_branch(SMALL)
    loop = np.select([branch == 1, branch == 2], [0.5, -0.5])[:, None] * np.ones(12)
    # 1 N at three levels, and nothing without a load
    assert "Loading and unloading differ, by 0.87 N RMS" in said(loop)
    assert "Loading" not in said(0.03 * LOAD[:, None] * np.ones(12))


@pytest.mark.parametrize(
    ("group", "words"),
    [
        (
            "pose",
            "It goes with the commanded pose: that alone predicts 70% of it",
        ),
        ("history", "It goes with where tensions last turned back"),
        ("gears", "It goes with gears"),
    ],
)
def test_what_it_goes_with(group, words):
    assert words in said(np.ones(12), model(alone_other=0.1, **{group: 0.7}))


def test_the_feature_that_it_goes_with_most_plainly():
    assert "not fitted, most plainly with size of the load." in said(np.ones(12), model(time=0.7))


def test_what_does_not_repeat():
    assert "does not repeat itself" in said(np.ones(12), model(-0.4, pose=-0.2))
    assert "does not repeat itself" not in said(np.ones(12), model(0.5, pose=0.25))


def test_a_step_and_jumps():
    planted = np.outer(np.arange(ROWS) >= 150, 1.3 * np.eye(12)[7])
    assert "at once and stays: cable 8 by +1.3 N at 30 s" in said(planted)
    planted = np.zeros((ROWS, 12))
    planted[[30, 66, 102], 4] = 9.0
    assert "It jumps while nothing moves: 6 times in cable 5 (by 9 N)" in said(planted)


ROWS_SWEEP = 500
rng = np.random.default_rng(2)
TIME_S = np.arange(ROWS_SWEEP) / 5.0
COMMAND = 0.18 * np.sin(np.outer(TIME_S, rng.uniform(0.15, 0.5, 8)) + rng.uniform(0.0, 6.0, 8))
LENGTH_M = held_lengths_m(mechanism_of(LAB), COMMAND)


def sweep(command: np.ndarray = COMMAND, segment: int = 0) -> Recording:
    return Recording(
        name="sweep",
        time_s=TIME_S,
        trial=np.zeros(ROWS_SWEEP, dtype=np.int64),
        command_rad=command,
        load_segment=np.full(ROWS_SWEEP, segment),
        load_n=np.zeros((ROWS_SWEEP, 3)),
        tensions_n=np.full((ROWS_SWEEP, 12), 50.0),
    )


def wave_in(planted: np.ndarray, recording: Recording | None = None):
    noise = rng.normal(0.0, FLOOR_N, (ROWS_SWEEP, 12))
    return periodic(recording or sweep(), noise + planted, FLOOR_N, LAB)


@pytest.mark.parametrize("period_rad", [0.07, 0.15])
def test_notches_of_a_joint(period_rad):
    wave = np.sin(2.0 * np.pi * COMMAND[:, 3] / period_rad)
    found = wave_in(np.outer(wave, rng.normal(size=12)))
    assert found is not None
    assert (found.along, found.unit) == ("joint_2_yaw", "rad")
    assert found.period == pytest.approx(period_rad, rel=0.08)
    assert found.share > 0.5


def test_the_screw_of_a_cable():
    wave = np.sin(2.0 * np.pi * LENGTH_M[:, 6] / 0.004)
    found = wave_in(np.outer(wave, np.eye(12)[6]))
    assert found is not None
    assert (found.along, found.unit) == ("cable_7", "m")
    assert found.period == pytest.approx(0.004, rel=0.08)


def test_screws_of_several_cables_that_are_alike():
    turns = 2.0 * np.pi * LENGTH_M / 0.003
    found = wave_in(np.sin(turns) * np.where(np.isin(np.arange(12), [1, 4, 9]), 1.0, 0.0))
    assert found is not None
    assert found.unit == "m"
    assert found.period == pytest.approx(0.003, rel=0.08)


def test_what_is_smooth_in_the_pose_is_no_wave():
    smooth = 30.0 * COMMAND[:, 0] + 200.0 * COMMAND[:, 1] * COMMAND[:, 4]
    assert wave_in(np.outer(smooth, rng.normal(size=12))) is None


def test_noise_is_no_wave():
    assert wave_in(np.zeros(12)) is None


def test_scatter_is_no_wave():
    assert wave_in(rng.normal(size=(ROWS_SWEEP, 12))) is None


def test_without_motion_or_without_unloaded_rows_there_is_nothing_to_see():
    loud = rng.normal(size=(ROWS_SWEEP, 12))
    assert wave_in(loud, sweep(np.zeros((ROWS_SWEEP, 8)))) is None
    assert wave_in(loud, sweep(segment=2)) is None


def noise() -> np.ndarray:
    return np.random.default_rng(6).normal(0.0, FLOOR_N, (ROWS, 12))


def test_noise_has_neither():
    assert steps(SMALL, noise(), FLOOR_N) == ()
    assert jumps(SMALL, noise(), FLOOR_N) == ()


def test_a_step_is_told_with_its_time_size_and_cable():
    planted = np.outer(np.arange(ROWS) >= 150, -1.3 * np.eye(12)[7])
    (found,) = steps(SMALL, noise() + planted, FLOOR_N)
    assert found.channel == 7
    assert found.time_s == pytest.approx(SMALL.time_s[150], abs=0.5)
    assert found.size_n == pytest.approx(-1.3, abs=0.1)


def test_a_load_that_comes_and_goes_is_no_step():
    load = np.linalg.norm(SMALL.load_n, axis=1)
    assert steps(SMALL, noise() + 0.1 * load[:, None], FLOOR_N) == ()


def test_a_step_at_the_very_end_is_not_told_from_chance():
    planted = np.outer(np.arange(ROWS) >= ROWS - 5, 2.0 * np.eye(12)[7])
    assert steps(SMALL, noise() + planted, FLOOR_N) == ()


def test_jumps_at_rest_are_counted():
    """There and back twice within one load, and once more each for some rows."""
    planted = np.zeros((ROWS, 12))
    planted[[30, 66], 4] = 9.0
    planted[138:140, 4] = -9.0
    (found,) = jumps(SMALL, noise() + planted, FLOOR_N)
    assert (found.channel, found.count) == (4, 5)
    assert found.size_n == pytest.approx(9.0, abs=0.5)


def test_what_comes_with_a_load_or_a_motion_is_no_jump():
    load = np.linalg.norm(SMALL.load_n, axis=1)
    moving = SMALL.trial == SMALL.trial.max()
    wild = np.random.default_rng(1).normal(0.0, 5.0, (ROWS, 12)) * moving[:, None]
    assert jumps(SMALL, noise() + load[:, None] + wild, FLOOR_N) == ()


@pytest.mark.parametrize("keeps", [0.2, 0.5, 0.8])
def test_what_is_late_after_a_load_is_no_jump(keeps):
    load = np.linalg.norm(SMALL.load_n, axis=1)
    late = np.zeros(ROWS)
    for row in range(1, ROWS):
        late[row] = keeps * (late[row - 1] + load[row] - load[row - 1])
    assert jumps(SMALL, noise() - late[:, None], FLOOR_N) == ()
