"""What the plant's actuators, sensors and manufacturing tolerances change."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from cablesense_plants.arm.listed import FILTERS, lagged, with_play_m


@settings(max_examples=30)
@given(arrays(float, (40, 3), elements=st.floats(-0.01, 0.01)), st.floats(-1.0, 1.0))
def test_play_lags_by_half_at_most_and_moves_only_when_taken_up(
    wanted: np.ndarray, start: float
) -> None:
    play = np.array([0.0, 1e-3, 4e-3])
    given_m = with_play_m(wanted, play, np.full(3, start))
    assert (np.abs(given_m - wanted) <= 0.5 * play + 1e-12).all()
    moved = np.diff(given_m, axis=0) != 0.0
    at_end = np.abs(np.abs(given_m - wanted) - 0.5 * play)[1:] <= 1e-12
    assert (at_end | ~moved).all()


LONG_S = 0.2 * np.arange(600)
STEP = np.where(LONG_S < 20.0, 50.0, 80.0)[:, None] * np.ones(3)


@pytest.mark.parametrize("kind", FILTERS)
def test_a_lagging_sensor_arrives_and_was_settled_before(kind: str) -> None:
    late = lagged(STEP, LONG_S, np.array([1.0, 0.0, 2.5]), kind)
    np.testing.assert_allclose(late[LONG_S < 19.9], 50.0)
    np.testing.assert_array_equal(late[:, 1], STEP[:, 1])
    np.testing.assert_allclose(late[-1], 80.0, atol=1e-6)
    below = (late < 79.9).sum(axis=0)
    assert below[1] < below[0] < below[2]
    assert (np.diff(late, axis=0) >= -1e-9).all()
