"""What good readings look like, by an arm's file."""

import pytest
from sensor_series import ARM

from cablesense_online.commissioning.sensor_check import LEAST_FLOOR_N, expectation


def test_bounds_are_the_arm_files():
    expected = expectation(ARM.sensors)
    assert expected.rate_hz == ARM.sensors.rate_hz
    assert expected.floor_n == pytest.approx((0.05**2 + 0.1813**2 / 12) ** 0.5)
    assert expected.noise_n == pytest.approx(2.0 * expected.floor_n)
    assert expected.jitter_s == pytest.approx(0.5 / expected.rate_hz)


def test_rate_and_drift_can_be_given():
    expected = expectation(ARM.sensors, 1000.0, 0.5)
    assert (expected.rate_hz, expected.drift_n) == (1000.0, 0.5)


def test_ideal_sensors_of_a_file_leave_room_for_real_ones():
    ideal = ARM.sensors.model_copy(update={"noise_std_n": 0.0, "step_n": 0.0})
    assert expectation(ideal).floor_n == LEAST_FLOOR_N
