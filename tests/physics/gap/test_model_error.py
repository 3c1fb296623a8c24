"""An error as it is expected counts half by its smooth part, and half by the rest."""

import numpy as np

from cablesense_gap.diagnosis.model_error import TwoParts

FOLD = np.repeat([0, 1, -1], 400)
ERROR = np.array([2.0, 0.5])


def test_an_error_as_expected_has_the_mean_square_of_the_rest():
    rng = np.random.default_rng(3)
    rows = len(FOLD)
    turn = np.linspace(0.0, 6.0 * np.pi, rows)
    columns = (
        np.array([np.sin(turn), np.cos(turn), 1e-3 * np.sin(90.0 * turn)]).T * ERROR[:, None, None]
    )
    scatter = rng.normal(0.0, 0.05, (rows, 2))
    drawn = np.einsum("crk,cnk->ncr", columns, rng.normal(size=(2, 300, 3))).swapaxes(1, 2)
    parts, deviation = TwoParts.of(columns, scatter + drawn[0], ERROR, 0.01, FOLD)
    np.testing.assert_allclose(deviation, 0.05, rtol=0.1)
    scaled = parts.scaled(scatter + drawn)
    counted = FOLD >= 0
    np.testing.assert_allclose((scaled[:, counted] ** 2).mean((0, 1)), deviation**2, rtol=0.15)
    smooth = parts.scaled(drawn)[:, counted]
    np.testing.assert_allclose((smooth**2).mean((0, 1)), 0.5 * deviation**2, rtol=0.15)
    np.testing.assert_allclose(parts.restored(scaled), scatter + drawn, atol=1e-12)
    np.testing.assert_array_equal(scaled[:, ~counted], (scatter + drawn)[:, ~counted])
    _, bounded = TwoParts.of(columns, 100.0 * scatter, ERROR, 0.01, FOLD)
    np.testing.assert_array_equal(bounded, ERROR)
