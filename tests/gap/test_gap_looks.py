"""What a residual looks like: the sentence fits what was planted, and no other is said."""

from __future__ import annotations

import numpy as np
import pytest
from gap_recordings import LAB, small_recording

from cablesense_gap.diagnosis.discrepancy import Discrepancy
from cablesense_gap.residual_patterns import looks_like
from cablesense_gap.residuals import load_branch

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
    return " ".join(looks_like(SMALL, noise + planted, found or model(), LAB, FLOOR_N))


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
