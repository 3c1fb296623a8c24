"""Calibration: none to find where outcomes are drawn as stated, the planted one where not."""

from __future__ import annotations

import numpy as np
import pytest

from cablesense_gap.scoring import calibrate

RNG = np.random.default_rng(8)
STATED = RNG.uniform(0.0, 1.0, 40_000)


def test_outcomes_drawn_as_stated_are_calibrated():
    found = calibrate(STATED, RNG.uniform(size=len(STATED)) < STATED)
    assert found.expected_error < 0.015
    assert found.brier == pytest.approx(1 / 6, abs=0.01)  # the mean of p (1 - p)
    assert len(found.bins) == 10


def test_too_much_confidence_is_found():
    found = calibrate(np.full(10_000, 0.95), RNG.uniform(size=10_000) < 0.75)
    assert found.expected_error == pytest.approx(0.2, abs=0.02)
    assert [b.count for b in found.bins] == [10_000]


def test_certainty_belongs_to_the_last_bin_and_can_be_perfect():
    found = calibrate([0.0, 1.0, 1.0], [False, True, True])
    assert (found.brier, found.expected_error) == (0.0, 0.0)
    assert [(b.low, b.high, b.count) for b in found.bins] == [(0.0, 0.1, 1), (0.9, 1.0, 2)]
