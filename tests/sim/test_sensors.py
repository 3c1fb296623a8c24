"""What the tension sensors make of a tension: noise, step and range."""

import numpy as np
import pytest

from cablesense_sim.arm import Sensors, open_arm
from cablesense_sim.sensors import difference_variance_n2, read_tensions_n, reading_variance_n2

SENSORS = open_arm("cdsm").sensors
MANY = 200_000


def with_(**changes: object) -> Sensors:
    return SENSORS.model_copy(update=changes)


def test_readings_are_multiples_of_the_step() -> None:
    readings = read_tensions_n(np.linspace(0, 300, 999), SENSORS, np.random.default_rng(0))
    steps = readings / 0.1813
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)


@pytest.mark.parametrize("noise_std_n", [0.0, 0.05, 0.5])
@pytest.mark.parametrize("step_n", [0.0, 0.1813])
def test_mean_and_variance_are_as_stated(noise_std_n: float, step_n: float) -> None:
    rng = np.random.default_rng(1)
    sensors = with_(noise_std_n=noise_std_n, step_n=step_n)
    truth = rng.uniform(10, 200, MANY)  # many steps wide, so that rounding is uniform
    error = read_tensions_n(truth, sensors, rng) - truth
    variance = reading_variance_n2(sensors)
    assert variance == pytest.approx(noise_std_n**2 + step_n**2 / 12)
    # five standard deviations of either estimate
    assert abs(error.mean()) <= 5 * np.sqrt(variance / MANY)
    assert error.var() == pytest.approx(variance, rel=5 * np.sqrt(2 / MANY), abs=1e-30)


def test_a_tared_difference_has_the_variance_of_both() -> None:
    rng = np.random.default_rng(2)
    unloaded = rng.uniform(10, 200, (4000, 1))
    tare = read_tensions_n(np.repeat(unloaded, 10, axis=1), with_(noise_std_n=0.5), rng).mean(1)
    reading = read_tensions_n(unloaded[:, 0] + 20.0, with_(noise_std_n=0.5), rng)
    spread = (reading - tare).var()
    expected = difference_variance_n2(with_(noise_std_n=0.5), tare_samples=10)
    assert spread == pytest.approx(expected, rel=5 * np.sqrt(2 / 4000))


def test_a_perfect_sensor_tells_the_truth() -> None:
    truth = np.random.default_rng(3).uniform(0, 200, (3, 4))
    perfect = with_(noise_std_n=0.0, step_n=0.0)
    np.testing.assert_array_equal(read_tensions_n(truth, perfect, np.random.default_rng(0)), truth)


def test_readings_saturate_at_the_ends_of_the_range() -> None:
    sensors = with_(range_n=(0.0, 100.0))
    readings = read_tensions_n([-50.0, 50.0, 500.0], sensors, np.random.default_rng(0))
    assert readings[0] == 0.0
    assert readings[1] == pytest.approx(50.0, abs=0.5)
    assert readings[2] == 100.0


def test_the_same_seed_reads_the_same() -> None:
    first, second = (
        read_tensions_n(np.full(12, 50.0), SENSORS, np.random.default_rng(9)) for _ in range(2)
    )
    np.testing.assert_array_equal(first, second)


def test_reading_leaves_the_truth_alone() -> None:
    truth = np.full(12, 50.0)
    read_tensions_n(truth, SENSORS, np.random.default_rng(0))
    np.testing.assert_array_equal(truth, 50.0)
