"""The flexible model: it explains what repeats, and only on what it has not seen."""

from __future__ import annotations

import numpy as np
import pytest

from cablesense_gap.diagnosis.discrepancy import LONG_ROWS, Discrepancy, Features, discrepancy

FLOOR = 0.1
TRIALS, ROWS = 15, 30
TRIAL = np.repeat(np.arange(TRIALS), ROWS)
FOLD = np.arange(TRIALS) % 5
USED = np.ones(len(TRIAL), dtype=bool)
rng = np.random.default_rng(11)
LEVEL = np.repeat(rng.uniform(-2.0, 2.0, (TRIALS * 10, 2)), 3, axis=0)
WAY = np.sign(np.sin(np.arange(len(TRIAL)) / 4.0))[:, None]
FEATURES = Features(
    np.concatenate([LEVEL, WAY], axis=1),
    ("level of one", "level of other", "way"),
    ("level", "level", "way"),
)


def noise(seed: int = 0, channels: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).normal(0.0, FLOOR, (len(TRIAL), channels))


def found_in(signal: np.ndarray, **changed) -> Discrepancy:
    given = {"trial": TRIAL, "fold": FOLD, "used": USED} | changed
    return discrepancy(FEATURES, noise() + signal, floor=FLOOR, **given)


def test_what_goes_with_a_feature_is_explained():
    found = found_in(np.tanh(2.0 * LEVEL[:, :1]) * [1.0, 0.0, -0.5])
    assert found.explained_share > 0.9
    assert found.by_channel[0] > 0.9
    assert found.foremost[0] == "level of one"


def test_the_group_that_explains_it_is_told():
    found = found_in(0.5 * WAY)
    assert found.alone["way"] > 0.8
    assert found.alone["level"] < 0.3


@pytest.mark.parametrize("seed", range(3))
def test_noise_is_not_explained(seed):
    found = discrepancy(FEATURES, noise(seed), TRIAL, FOLD, USED, 0.8 * FLOOR)
    assert found.explained_share < 0.1


def test_what_differs_from_trial_to_trial_is_not_explained():
    chance = np.random.default_rng(8).normal(size=(TRIALS, 1))[TRIAL]
    assert found_in(chance).explained_share < 0.2


def test_nothing_beyond_the_floor_is_nothing_to_explain():
    found = found_in(np.zeros((1, 3)), used=USED)
    quiet = discrepancy(FEATURES, 0.5 * noise(), TRIAL, FOLD, USED, FLOOR)
    assert quiet.explained_share == 0.0
    assert abs(found.explained_share) < 1.0 + 1e-9


def test_a_long_trial_is_held_out_in_stretches():
    """Only one counts: nothing would be left to learn from if it were held out whole."""
    trial = np.repeat([0, 1, 2], [LONG_ROWS + 180, 75, 75])
    found = found_in(np.tanh(2.0 * LEVEL[:, :1]), trial=trial, fold=np.arange(3), used=trial == 0)
    assert found.explained_share > 0.5


def test_rows_that_do_not_count_say_nothing():
    used = USED.copy()
    used[40:90] = False
    spoilt = np.where(used[:, None], np.tanh(LEVEL[:, :1]), 1e3)
    assert found_in(spoilt, used=used).explained_share > 0.9


def test_a_feature_that_never_changes_does_no_harm():
    still = Features(
        np.column_stack([FEATURES.values, np.full(len(TRIAL), 4.0)]),
        (*FEATURES.names, "still"),
        (*FEATURES.groups, "still"),
    )
    found = discrepancy(still, noise() + LEVEL[:, :1], TRIAL, FOLD, USED, FLOOR)
    assert found.explained_share > 0.9
    assert "still" not in found.foremost


def test_two_folds_are_too_few():
    with pytest.raises(ValueError, match="2 folds of trials; at least 3"):
        found_in(np.zeros((1, 3)), fold=np.arange(TRIALS) % 2)
