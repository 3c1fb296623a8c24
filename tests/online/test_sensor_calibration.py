"""A sensor from known loads: planted values come back as often as stated; or it is refused."""

import numpy as np
import pytest

from cablesense_online.commissioning.sensor_calibration import CalibrationPoint, calibrate_sensor
from cablesense_online.commissioning.tables import CommissioningError

UP_AND_DOWN_N = (0.0, 20.0, 40.0, 60.0, 80.0, 60.0, 40.0, 20.0, 0.0)
SCALE, ZERO = 0.0125, -310.0
DRAWS = 1200


def points(force_n=UP_AND_DOWN_N, noise_n=None, scale=SCALE, zero=ZERO, raw_u=0.0):
    noise_n = np.zeros(len(force_n)) if noise_n is None else noise_n
    return [
        CalibrationPoint(force, zero + (force + error) / scale, raw_u=raw_u)
        for force, error in zip(force_n, noise_n, strict=True)
    ]


def test_planted_scale_and_zero_come_back():
    found = calibrate_sensor("cable_1", points())
    assert found.scale_n_per_unit == pytest.approx(SCALE)
    assert found.zero == pytest.approx(ZERO)
    assert found.points == 9
    assert found.largest_force_n == 80.0


@pytest.mark.parametrize("raw_u", [0.0, 0.3 / SCALE])
def test_the_stated_uncertainty_covers_the_truth_in_95_of_100_draws(raw_u):
    draw = np.random.default_rng(4)
    hits = np.zeros(3)
    for _ in range(DRAWS):
        found = calibrate_sensor("c", points(noise_n=draw.normal(0.0, 0.3, 9), raw_u=raw_u))
        top_n = found.scale_n_per_unit * (ZERO + 80.0 / SCALE - found.zero)
        hits += (
            abs(found.scale_n_per_unit - SCALE) <= found.scale_u95_n_per_unit,
            abs(found.zero - ZERO) <= found.zero_u95,
            abs(top_n - 80.0) <= found.tension_u95_n,
        )
    share = hits / DRAWS
    least, most = 0.95 - 0.025, (0.95 + 0.025 if raw_u == 0.0 else 0.995)
    assert (share >= least).all(), share
    assert (share[:2] <= most).all(), share


def test_what_all_loads_share_is_covered_as_well():
    draw = np.random.default_rng(5)
    common_u = 0.01
    hits = 0
    for _ in range(DRAWS):
        wrong_by = 1.0 + draw.normal(0.0, common_u)
        made = points(np.multiply(UP_AND_DOWN_N, wrong_by), draw.normal(0.0, 0.3, 9))
        noted = [
            CalibrationPoint(force, point.raw)
            for force, point in zip(UP_AND_DOWN_N, made, strict=True)
        ]
        found = calibrate_sensor("c", noted, common_u)
        hits += abs(found.scale_n_per_unit - SCALE) <= found.scale_u95_n_per_unit
    assert 0.925 <= hits / DRAWS <= 0.975


def test_characteristics_of_a_sensor_with_a_loop():
    loop_n = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.6, 0.8, 0.6, 0.0])
    found = calibrate_sensor("c", points(noise_n=loop_n))
    assert found.hysteresis_n == pytest.approx(0.8, rel=0.02)


def test_the_worst_point_is_named():
    error_n = np.zeros(9)
    error_n[5] = 2.0
    found = calibrate_sensor("c", points(noise_n=error_n))
    assert found.largest_residual_at == 5
    assert found.largest_residual_n == pytest.approx(2.0, rel=0.3)


@pytest.mark.parametrize(
    ("force_n", "remedy"),
    [
        ((0.0, 10.0, 20.0, 30.0), "at least 5"),
        ((0.0, 50.0, 0.0, 50.0, 0.0, 50.0), "only 2 sizes"),
        ((60.0, 70.0, 80.0, 90.0, 100.0), "at least half of the largest"),
        ((0.0,) * 6, "only 1 size;"),
    ],
)
def test_too_few_or_too_close_loads_are_refused(force_n, remedy):
    with pytest.raises(CommissioningError, match=f"cable_7: .*{remedy}"):
        calibrate_sensor("cable_7", points(force_n))


def test_readings_that_do_not_follow_are_refused():
    draw = np.random.default_rng(6)
    still = [CalibrationPoint(force, 12.0) for force in UP_AND_DOWN_N]
    random = [CalibrationPoint(force, draw.normal()) for force in UP_AND_DOWN_N]
    for readings in (still, random):
        with pytest.raises(CommissioningError, match="do not follow"):
            calibrate_sensor("cable_2", readings)


def test_uncertainties_are_given_for_all_loads_or_none():
    given = points()
    given[0] = CalibrationPoint(0.0, ZERO, raw_u=1.0)
    with pytest.raises(CommissioningError, match="1 of 9 loads"):
        calibrate_sensor("c", given)
