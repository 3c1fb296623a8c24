"""What to record about a gap without a name: the trial that shows most, and how to vary it."""

from __future__ import annotations

import numpy as np
import pytest
from gap_recordings import small_recording

from cablesense_gap.unlisted import closer_look

SMALL = small_recording()


def shown_in(trial: int):
    large = np.where((SMALL.trial == trial)[:, None], 2.0, 0.2)
    return closer_look(SMALL, np.broadcast_to(large, SMALL.tensions_n.shape), 0.1)


def test_a_load_is_told_with_segment_side_size_and_pose():
    found = shown_in(2)
    assert found.block == "Load segment 2 down up to 40 N, arm straight."
    assert (
        "trial 2: load segment 2 down up to 40 N, arm straight. There 2 N are left" in found.text
    )
    assert "20 times the noise floor" in found.text
    assert (found.separation_n, found.over_floor) == (pytest.approx(2.0), pytest.approx(20.0))
    assert "half as far" in found.text


def test_a_bent_pose_is_said():
    assert "arm bent as then (up to 5.7 degrees)" in shown_in(7).block


def test_a_sweep_is_told_with_its_joint():
    found = shown_in(9)
    assert found.block == "Move joint 2 by 14 degrees in all."
    assert "one joint at a time" in found.text


def test_a_rest_is_to_be_left_longer():
    found = shown_in(0)
    assert found.block == "Leave the arm alone, arm straight."
    assert "ten minutes" in found.text


def test_another_direction_is_told_by_numbers():
    turned = SMALL.load_n[:, [2, 1, 0]]
    sideways = type(SMALL)(**{**vars(SMALL), "load_n": turned})
    found = closer_look(
        sideways, np.where((SMALL.trial == 1)[:, None], 2.0, 0.1) * np.ones(12), 0.1
    )
    assert "along (-1.00, 0.00, 0.00) of the base frame" in found.text


def test_trials_of_a_few_rows_do_not_count():
    short = SMALL.rows(np.r_[0:30, 60:65])
    loud = np.where((short.trial == short.trial.max())[:, None], 9.0, 0.1) * np.ones(12)
    assert "trial 0" in closer_look(short, loud, 0.1).text
    with pytest.raises(ValueError, match="no trial has 10 rows"):
        closer_look(SMALL.rows(slice(0, 5)), np.ones((5, 12)), 0.1)
