"""Figures of merit on planted cases, and macro F1 against scikit-learn."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from cablesense_training.evaluation.metrics import (
    ContactAnswer,
    ContactTruth,
    angle_difference_deg,
    confusion_matrix,
    macro_f1,
    multi_contact_metrics,
    single_contact_metrics,
)

CLASSES = hnp.arrays(np.int64, 40, elements=st.integers(0, 4))


def _truth(segment, angle_deg, magnitude_n):
    return ContactTruth(np.array(segment), np.array(angle_deg), np.array(magnitude_n))


def _answer(segment, angle_deg, magnitude_n, std=1.0):
    wide = np.full(len(segment), std)
    return ContactAnswer(np.array(segment), np.array(angle_deg), np.array(magnitude_n), wide, wide)


@pytest.mark.slow
@given(true=CLASSES, answered=CLASSES)
def test_macro_f1_agrees_with_scikit_learn(true, answered):
    from sklearn.metrics import f1_score

    expected = f1_score(true, answered, average="macro", zero_division=0.0)
    assert macro_f1(confusion_matrix(true, answered, 5)) == pytest.approx(expected)


@given(a=st.floats(-1e4, 1e4), turns=st.integers(-5, 5))
def test_angle_difference_goes_the_short_way(a, turns):
    assert angle_difference_deg(a + 360.0 * turns + 3.0, a) == pytest.approx(3.0, abs=1e-6)


def test_perfect_answers():
    truth = _truth([0, 1, 2, 3, 4], [0.0, 10.0, 359.0, 90.0, 45.0], [0.0, 1.0, 5.0, 60.0, 200.0])
    answer = _answer(truth.segment, truth.angle_deg, truth.magnitude_n)
    figures = single_contact_metrics(truth, answer, 4)
    assert figures.contact_accuracy == figures.macro_f1 == figures.coverage95 == 1.0
    assert figures.errors.magnitude_mae_n == figures.errors.direction_mae_deg == 0.0
    assert [b.errors.contacts for b in figures.bins] == [1, 1, 0, 1, 1]
    assert math.isnan(figures.bins[2].errors.magnitude_mae_n)


def test_a_missed_contact_counts_as_zero_newtons_and_has_no_direction():
    truth = _truth([1, 1], [10.0, 10.0], [30.0, 50.0])
    answer = _answer([1, 0], [350.0, 123.0], [34.0, 49.0])
    errors = single_contact_metrics(truth, answer, 4).errors
    assert (errors.contacts, errors.found) == (2, 1)
    assert errors.direction_mae_deg == pytest.approx(20.0)
    assert errors.magnitude_mae_n == pytest.approx((4.0 + 50.0) / 2.0)
    assert errors.magnitude_rmse_n == pytest.approx(math.sqrt((16.0 + 2500.0) / 2.0))
    assert errors.contact_accuracy == 0.5


def test_coverage_of_honest_gaussian_errors_is_95_percent():
    rng = np.random.default_rng(0)
    n = 20_000
    std = 3.0
    truth = _truth(np.ones(n, int), np.full(n, 359.0), np.full(n, 50.0))
    answer = _answer(
        np.ones(n, int),
        (truth.angle_deg + rng.normal(0.0, std, n)) % 360.0,
        truth.magnitude_n + rng.normal(0.0, std, n),
        std,
    )
    figures = single_contact_metrics(truth, answer, 4)
    assert figures.errors.magnitude_coverage95 == pytest.approx(0.95, abs=0.01)
    assert figures.errors.direction_coverage95 == pytest.approx(0.95, abs=0.01)


def test_multi_contact_by_hand():
    touched = [[True, False], [True, True]]
    force = [[20.0, 0.0], [1.0, 30.0]]
    answered = [[True, True], [False, True]]
    figures = multi_contact_metrics(touched, force, answered, [[22.0, 3.0], [0.5, 29.0]])
    assert figures.judged == 4
    assert figures.recognition_accuracy == 0.5
    assert figures.all_segments_right == 0.0
    # each segment has one hit and one mistake: F1 = 2/3
    assert figures.macro_f1 == pytest.approx(2 / 3)
    assert figures.magnitude_mae_n == pytest.approx(((2.0 + 1.0) / 2, 1.0))
