"""The flexible model: it explains what repeats, and only on rows that it has not seen."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from cablesense_gap.diagnosis.discrepancy import (
    Discrepancy,
    Features,
    discrepancy,
    held_out,
    kernel,
)

FLOOR = 0.1
TRIALS, ROWS = 15, 30
TRIAL = np.repeat(np.arange(TRIALS), ROWS)
FOLD = np.arange(TRIALS) % 5
USED = np.ones(len(TRIAL), dtype=bool)
rng = np.random.default_rng(11)
LEVEL = np.repeat(rng.uniform(-2.0, 2.0, (TRIALS * 10, 2)), 3, axis=0)
WAY = np.sign(np.sin(np.arange(len(TRIAL)) / 4.0))[:, None]
STILL = np.full((len(TRIAL), 1), 4.0)
FEATURES = Features(
    np.concatenate([LEVEL, WAY, STILL], axis=1),
    ("level of one", "level of other", "way", "still"),
    ("level", "level", "way", "still"),
)
NOISE = rng.normal(0.0, FLOOR, (len(TRIAL), 3))
BENT = np.tanh(2.0 * LEVEL[:, :1])


def found_in(signal: np.ndarray, floor: float = FLOOR, **changed) -> Discrepancy:
    given = {"trial": TRIAL, "fold": FOLD, "used": USED} | changed
    return discrepancy(FEATURES, NOISE + signal, floor=floor, **given)


def test_the_group_of_features_that_explains_a_residual_is_told():
    found = found_in(BENT * [1.0, 0.0, -0.5])
    assert found.explained_share > 0.9
    assert found.alone["level"] > 0.8
    assert found.alone["way"] < 0.3
    assert found.foremost == "level of one"
    assert found_in(0.5 * WAY).alone["way"] > 0.8


def test_noise_and_what_differs_from_trial_to_trial_are_not_explained():
    assert found_in(0.0 * NOISE, floor=0.8 * FLOOR).explained_share < 0.1
    chance = np.random.default_rng(8).normal(size=(TRIALS, 1))[TRIAL]
    assert found_in(chance).explained_share < 0.2
    assert found_in(-0.5 * NOISE).explained_share == 0.0  # nothing is beyond the floor


def test_a_long_trial_is_held_out_in_stretches():
    """Only one counts: nothing would be left to learn from if it were held out whole."""
    trial = np.repeat([0, 1, 2], [300, 75, 75])
    found = found_in(BENT, trial=trial, fold=np.arange(3), used=trial == 0)
    assert found.explained_share > 0.5


def test_rows_that_do_not_count_say_nothing():
    used = USED.copy()
    used[40:90] = False
    spoilt = np.where(used[:, None], np.tanh(LEVEL[:, :1]), 1e3)
    assert found_in(spoilt, used=used).explained_share > 0.9


def test_two_folds_are_too_few():
    with pytest.raises(ValueError, match="2 folds of trials; at least 3"):
        found_in(0.0 * NOISE, fold=np.arange(TRIALS) % 2)


COUNT = 150
X = rng.uniform(-2.0, 2.0, (COUNT, 2))
FOLDS = np.arange(COUNT) // 10 % 5
ALL = np.ones(COUNT, dtype=bool)
WAVE = np.sin(2.0 * X[:, :1])


def left(y: np.ndarray, *groups: np.ndarray) -> np.ndarray:
    predicted = held_out(kernel(groups or [X]), y, FOLDS, ALL)
    return ((y - predicted) ** 2).mean(0) / (y**2).mean(0)


def test_a_kernel_is_symmetric_and_has_no_negative_direction():
    found = kernel([X, X[:, :1] ** 2])
    assert_allclose(found, found.T)
    assert np.linalg.eigvalsh(found).min() > -1e-9 * np.linalg.eigvalsh(found).max()


def test_straight_and_bent_functions_are_predicted_and_noise_is_not():
    share = left(np.column_stack([X @ [1.0, -2.0], WAVE, rng.normal(size=COUNT)]))
    assert share[0] < 1e-3
    assert share[1] < 0.05
    assert 0.95 < share[2] < 1.1


def test_a_product_of_two_groups_is_predicted_by_both_alone_by_neither():
    y = (X[:, 0] * X[:, 1])[:, None]
    assert left(y, X[:, :1], X[:, 1:])[0] < 0.1
    assert left(y, X[:, :1])[0] > 0.8


def test_a_fold_is_predicted_without_its_own_rows_and_those_that_do_not_count():
    used = rng.random(COUNT) < 0.8
    other = np.where(used[:, None], WAVE, 99.0)
    other[FOLDS == 2] += 7.0
    before, after = (held_out(kernel([X]), each, FOLDS, used) for each in (WAVE, other))
    assert_array_equal(before[FOLDS == 2], after[FOLDS == 2])
