"""Folds: whole trials, and some of every kind left to fit to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gap_recordings import small_recording

from cablesense_gap.diagnose import FOLDS, folds_of
from cablesense_gap.recordings.recording import Recording


def trials(kinds: list[tuple[int, bool]], rows: int = 4) -> Recording:
    """A recording of trials, each with a segment that is loaded, and moving or not."""
    count = rows * len(kinds)
    command = np.zeros((count, 8))
    command[:, 0] = np.tile(np.linspace(0.0, 0.1, rows), len(kinds))
    command[np.repeat([not moves for _, moves in kinds], rows)] = 0.0
    segment = np.repeat([segment for segment, _ in kinds], rows)
    return Recording(
        name="trials",
        time_s=0.2 * np.arange(count),
        trial=np.repeat(np.arange(len(kinds)), rows),
        command_rad=command,
        load_segment=segment,
        load_n=np.outer(segment > 0, [0.0, 0.0, -5.0]),
        tensions_n=np.full((count, 12), 50.0),
    )


def test_every_trial_has_a_fold_and_the_folds_are_alike_in_size():
    fold = folds_of(small_recording())
    assert len(fold) == 10
    assert set(fold) == set(range(FOLDS))
    assert np.ptp(np.bincount(fold)) <= 1


def test_trials_of_one_kind_are_in_folds_of_their_own():
    kinds = [(0, True), (1, False), (2, False), (0, False)] * FOLDS
    fold = folds_of(trials(kinds))
    for kind in set(kinds):
        assert sorted(fold[[k == kind for k in kinds]]) == list(range(FOLDS))


def test_what_few_trials_there_are_are_held_out_one_by_one():
    assert sorted(folds_of(trials([(1, False), (0, True)]))) == [0, 1]


def test_numbers_of_trials_may_have_gaps():
    recorded = small_recording()
    renumbered = replace(recorded, trial=7 * recorded.trial + 3)
    assert folds_of(renumbered).tolist() == folds_of(recorded).tolist()


@pytest.mark.parametrize("moves", [False, True])
def test_a_load_counts_however_short_it_is(moves: bool):
    """A cycle begins and ends without a load; its kind is that of its loaded rows."""
    recorded = trials([(3, moves)] * 4 + [(0, moves)] * 4)
    brief = recorded.load_segment.copy()
    brief[::4] = 0
    shortened = replace(recorded, load_segment=brief)
    assert folds_of(shortened).tolist() == folds_of(recorded).tolist()
