"""Nonlinearity, hysteresis and repeatability, each alone and where loads do not show it."""

import numpy as np
import pytest

from cablesense_online.commissioning.sensor_calibration import (
    load_numbers,
    residual_characteristics,
)

LOOP_N = np.array([0.0, 50.0, 100.0, 50.0, 0.0])


def test_the_loop_is_between_falling_and_rising():
    found = residual_characteristics(LOOP_N, np.array([0.0, -0.5, 0.25, 1.0, 0.125]))
    assert found["hysteresis_n"] == pytest.approx(1.5)
    assert found["nonlinearity_n"] == pytest.approx(0.5)
    assert found["repeatability_n"] is None


def test_loads_put_on_again_show_repeatability():
    found = residual_characteristics(
        np.tile([0.0, 50.0, 100.0], 2), np.array([0, 0, 0, 0, 0.75, 0.0])
    )
    assert found["repeatability_n"] == pytest.approx(0.75)


def test_rising_loads_alone_show_no_loop():
    found = residual_characteristics(np.array([0.0, 50.0, 100.0]), np.array([0.1, -0.2, 0.1]))
    assert found["hysteresis_n"] is None
    assert found["nonlinearity_n"] == pytest.approx(0.2)


def test_nearly_the_same_weight_is_the_same_load():
    assert load_numbers(np.array([100.0, 0.0, 50.0, 50.2])).tolist() == [2, 0, 1, 1]
