"""What the plant's actuators, sensors and manufacturing tolerances change."""

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from cablesense_plants.arm.arm import ActuatorFaults, Filter, SensorFaults

IDEAL = ActuatorFaults()
TIME_S = 0.2 * np.arange(40)


@settings(max_examples=30)
@given(arrays(float, (40, 3), elements=st.floats(-0.01, 0.01)), st.floats(-1.0, 1.0))
def test_play_lags_by_half_at_most_and_moves_only_when_taken_up(
    wanted: np.ndarray, start: float
) -> None:
    play = np.array([0.0, 1e-3, 4e-3])
    loose = replace(IDEAL, play_m=play, play_start=np.full(3, start))
    given_m = loose.paid_out_m(wanted, TIME_S)
    assert (np.abs(given_m - wanted) <= 0.5 * play + 1e-12).all()
    moved = np.diff(given_m, axis=0) != 0.0
    at_end = np.abs(np.abs(given_m - wanted) - 0.5 * play)[1:] <= 1e-12
    assert (at_end | ~moved).all()


LONG_S = 0.2 * np.arange(600)
STEP = np.where(LONG_S < 20.0, 50.0, 80.0)[:, None] * np.ones(3)


def sensors(**changes: object) -> SensorFaults:
    return SensorFaults(50.0, **changes)


@pytest.mark.parametrize("kind", get_args(Filter))
def test_a_lagging_sensor_arrives_and_was_settled_before(kind: str) -> None:
    late = sensors(lag_s=np.array([1.0, 0.0, 2.5]), lag_filter=kind).signals_n(STEP, LONG_S)
    np.testing.assert_allclose(late[LONG_S < 19.9], 50.0)
    np.testing.assert_array_equal(late[:, 1], STEP[:, 1])
    np.testing.assert_allclose(late[-1], 80.0, atol=1e-6)
    below = (late < 79.9).sum(axis=0)
    assert below[1] < below[0] < below[2]
    assert (np.diff(late, axis=0) >= -1e-9).all()
