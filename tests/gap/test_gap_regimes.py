"""Regimes are named where a planted gap is, and only there."""

from __future__ import annotations

import numpy as np
import pytest
from gap_recordings import LAB, small_recording

from cablesense_gap.residuals import EVERYWHERE, decompose, load_branch, regimes, row_groups

SMALL = small_recording()
FLOOR_N = 0.1
ROWS = {(group, member): rows for group, member, rows in row_groups(SMALL)}


def found_for(planted):
    noise = np.random.default_rng(4).normal(0.0, FLOOR_N, SMALL.tensions_n.shape)
    return regimes(decompose(SMALL, noise + planted, FLOOR_N, LAB))


def test_noise_has_no_regime():
    assert found_for(0.0) == []


def test_an_offset_is_everywhere():
    assert found_for(np.eye(12)[3]) == [EVERYWHERE]


@pytest.mark.parametrize(
    ("group", "member", "words"),
    [
        ("loaded segment", "segment_2", "load on segment 2"),
        ("pose", "bent", "bent poses"),
        ("joint bent most", "joint_2", "joint 2 bent most"),
        ("load level", "above 27 N", "loads above 27 N"),
        ("rest and motion", "moving", "moving"),
        ("time", "late", "late in the recording"),
    ],
)
def test_the_regime_of_a_planted_gap_is_named(group, member, words):
    rows = ROWS[group, member]
    assert words in found_for(np.where(rows[:, None], 1.0, 0.0))


def test_friction_is_named_as_loading_against_unloading():
    branch = load_branch(SMALL)
    assert "loading against unloading" in found_for(
        np.select([branch == 1, branch == 2], [0.5, -0.5])[:, None]
    )


def test_the_largest_is_named_first():
    planted = np.where(ROWS["loaded segment", "segment_1"], 1.8, 0.0)
    planted += np.where(ROWS["rest and motion", "moving"], 2.5, 0.0)
    found = found_for(planted[:, None])
    assert found.index("moving") < found.index("load on segment 1")
