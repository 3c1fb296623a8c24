"""The flexible model: it explains what repeats, and only on what it has not seen."""

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
    trial = np.repeat([0, 1, 2], [300, 75, 75])
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


rng_kernel = np.random.default_rng(3)
ROWS_KERNEL = 150
X = rng_kernel.uniform(-2.0, 2.0, (ROWS_KERNEL, 2))
FOLD_KERNEL = np.arange(ROWS_KERNEL) // 10 % 5
ALL = np.ones(ROWS_KERNEL, dtype=bool)


def left(y: np.ndarray, *groups: np.ndarray, used: np.ndarray = ALL) -> np.ndarray:
    predicted = held_out(kernel(groups or [X]), y, FOLD_KERNEL, used)
    return ((y - predicted) ** 2).mean(0) / (y**2).mean(0)


def test_a_kernel_is_symmetric_and_has_no_negative_direction():
    found = kernel([X, X[:, :1] ** 2])
    assert_allclose(found, found.T)
    assert np.linalg.eigvalsh(found).min() > -1e-9 * np.linalg.eigvalsh(found).max()


def test_straight_and_bent_functions_are_predicted_and_noise_is_not():
    y = np.column_stack(
        [
            X @ [1.0, -2.0],
            np.sin(2.0 * X[:, 0]),
            rng_kernel.normal(size=ROWS_KERNEL),
        ]
    )
    share = left(y)
    assert share[0] < 1e-3
    assert share[1] < 0.05
    assert 0.95 < share[2] < 1.1


def test_what_two_groups_make_together_is_predicted_by_both_alone_by_neither():
    y = (X[:, 0] * X[:, 1])[:, None]
    assert left(y, X[:, :1], X[:, 1:])[0] < 0.1
    assert left(y, X[:, :1])[0] > 0.8


def test_a_fold_is_predicted_without_its_own_rows():
    y = np.sin(2.0 * X[:, :1])
    other = y.copy()
    other[FOLD_KERNEL == 2] += 7.0
    before, after = (held_out(kernel([X]), each, FOLD_KERNEL, ALL) for each in (y, other))
    assert_array_equal(before[FOLD_KERNEL == 2], after[FOLD_KERNEL == 2])


def test_rows_that_do_not_count_are_not_learnt_from():
    used = rng_kernel.random(ROWS_KERNEL) < 0.8
    y = np.sin(2.0 * X[:, :1])
    other = np.where(used[:, None], y, 99.0)
    first, second = (held_out(kernel([X]), each, FOLD_KERNEL, used) for each in (y, other))
    assert_array_equal(first, second)
