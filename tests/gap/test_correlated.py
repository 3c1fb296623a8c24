"""Deviations that are alike from row to row become independent, as by their covariance."""

import numpy as np
import pytest

from cablesense_gap.diagnosis.correlated import Correlated

FOLD = np.repeat([0, 1, -1], 8)


@pytest.mark.parametrize("columns", [3, 20])
def test_whitened_deviations_are_independent_in_each_fold(columns):
    rng, rows, unit = np.random.default_rng(3), len(FOLD), np.eye(len(FOLD))
    alike, deviation = rng.normal(size=(2, rows, columns)), rng.uniform(0.5, 2.0, (rows, 2))
    found = Correlated.of(alike, deviation, FOLD)
    each = np.stack([unit, 0.0 * unit], axis=2)  # as many values as rows, in the first channel
    by_row = found.whitened(each)
    np.testing.assert_allclose(found.coloured(by_row), each, atol=1e-12)
    np.testing.assert_array_equal(by_row[..., 1], 0.0)
    np.testing.assert_array_equal(by_row[:, FOLD < 0, 0], unit[:, FOLD < 0])
    for fold in (0, 1):
        own = fold == FOLD
        relative = alike[0, own] / deviation[own, :1]
        covariance = np.eye(own.sum()) + relative @ relative.T
        whitening = by_row[own][:, own, 0]
        np.testing.assert_allclose(
            whitening.T @ covariance @ whitening, np.eye(own.sum()), atol=1e-9
        )
