"""Scale and zero from known loads: exact, weighted, with uncertainty, or refused."""

from datetime import UTC, datetime

import numpy as np
import pytest
from can_frames import PACKED, PACKED_DATABASE
from hypothesis import assume, given
from hypothesis import strategies as st

from cablesense_gap.recordings.recording import Recording
from cablesense_online.can.calibration import calibrated
from cablesense_online.commissioning.sensor_calibration import (
    CalibrationPoint,
    calibrate_sensor,
    calibration_point,
    calibration_record,
    fit_line,
    load_numbers,
    residual_characteristics,
)
from cablesense_online.commissioning.tables import CommissioningError, KnownLoad, TimeWindow

UP_AND_DOWN_N = (0.0, 20.0, 40.0, 60.0, 80.0, 60.0, 40.0, 20.0, 0.0)
SCALE, ZERO = 0.0125, -310.0
DRAWS = 600


def points(force_n=UP_AND_DOWN_N, noise_n=None, scale=SCALE, zero=ZERO, raw_u=0.0):
    noise_n = np.zeros(len(force_n)) if noise_n is None else noise_n
    return [
        CalibrationPoint(force, zero + (force + error) / scale, raw_u=raw_u)
        for force, error in zip(force_n, noise_n, strict=True)
    ]


@pytest.mark.slow
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


@pytest.mark.slow
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


FORCES_N = np.array([0.0, 20.0, 40.0, 60.0, 80.0, 100.0])
NONE = np.zeros(6)


@given(
    st.floats(1e-6, 1e4) | st.floats(-1e4, -1e-6),
    st.floats(-1e5, 1e5),
)
def test_readings_without_error_give_back_scale_and_zero(scale, zero):
    raw = zero + FORCES_N / scale
    assume(100.0 / abs(scale) > 1e-5 * abs(raw).max())
    line = fit_line(FORCES_N, raw, NONE, NONE)
    assert line.scale_n_per_unit == pytest.approx(scale, rel=1e-6)
    assert line.zero == pytest.approx(zero, abs=1e-6 * (abs(zero) + 100.0 / abs(scale)))
    assert line.degrees_of_freedom == 4


def test_an_unsure_reading_counts_for_little():
    raw = 5.0 + 2.0 * FORCES_N
    raw[3] += 10.0
    sure = np.where(np.arange(6) == 3, 100.0, 0.1)
    assert fit_line(FORCES_N, raw, NONE, sure).zero == pytest.approx(5.0, abs=1e-3)
    assert abs(fit_line(FORCES_N, raw, NONE, NONE).zero - 5.0) > 0.1


def test_given_uncertainties_are_not_undercut_by_luck():
    raw = 5.0 + 2.0 * FORCES_N
    line = fit_line(FORCES_N, raw, NONE, np.full(6, 1.0))
    design = np.stack([np.ones(6), FORCES_N], axis=1)
    np.testing.assert_allclose(line.covariance, np.linalg.inv(design.T @ design))
    unsure_loads = fit_line(FORCES_N, raw, np.full(6, 0.5), np.full(6, 1.0))
    np.testing.assert_allclose(unsure_loads.covariance, 2.0 * line.covariance, rtol=1e-6)


@given(st.floats(0.01, 1.0), st.floats(1.0, 500.0))
def test_uncertainties_scale_with_the_units(noise, factor):
    raw = 7.0 + 3.0 * FORCES_N + noise * np.array([1.0, -1.0, 0.5, -0.5, 1.0, -0.5])
    line = fit_line(FORCES_N, raw, NONE, NONE)
    other = fit_line(FORCES_N, factor * raw, NONE, NONE)
    assert other.zero_u == pytest.approx(factor * line.zero_u, rel=1e-6)
    assert other.scale_u_n_per_unit == pytest.approx(line.scale_u_n_per_unit / factor, rel=1e-6)
    assert other.force_u_n(50.0) == pytest.approx(line.force_u_n(50.0), rel=1e-6)
    assert line.force_u_n(50.0) < line.force_u_n(0.0)


@pytest.mark.parametrize(
    ("force_n", "residual_n", "nonlinearity_n", "hysteresis_n", "repeatability_n"),
    [
        ([0, 50, 100, 50, 0], [0.0, -0.5, 0.25, 1.0, 0.125], 0.5, 1.5, None),
        ([0, 50, 100, 0, 50, 100], [0.0, 0.0, 0.0, 0.0, 0.75, 0.0], 0.375, 0.0, 0.75),
        ([0, 50, 100], [0.1, -0.2, 0.1], 0.2, None, None),
    ],
    ids=["up and down", "repeated", "rising only"],
)
def test_characteristics_follow_from_the_order_of_the_loads(
    force_n, residual_n, nonlinearity_n, hysteresis_n, repeatability_n
):
    found = residual_characteristics(np.array(force_n, dtype=float), np.array(residual_n))
    assert found == {
        "nonlinearity_n": pytest.approx(nonlinearity_n),
        "hysteresis_n": hysteresis_n and pytest.approx(hysteresis_n),
        "repeatability_n": repeatability_n and pytest.approx(repeatability_n),
    }


def test_nearly_the_same_weight_is_the_same_load():
    assert load_numbers(np.array([100.0, 0.0, 50.0, 50.2])).tolist() == [2, 0, 1, 1]


TIME_S = np.arange(0.0, 20.0, 0.1)


def recording(tensions_n):
    rows = len(TIME_S)
    return Recording(
        "run",
        TIME_S,
        np.zeros(rows, dtype=np.int64),
        np.zeros((rows, 8)),
        np.zeros(rows, dtype=np.int64),
        np.zeros((rows, 3)),
        tensions_n,
    )


def load(reading):
    return KnownLoad("l.csv: line 2", "cable_3", True, 20.0, 0.1, reading, 0.0)


def test_a_window_gives_the_signal_value_whatever_scale_was_in_force():
    channel = PACKED.channels["cable_3"].model_copy(update={"scale_n_per_unit": 0.5, "zero": 10.0})
    as_recorded = PACKED.model_copy(update={"channels": {**PACKED.channels, "cable_3": channel}})
    tensions_n = np.zeros((len(TIME_S), 12))
    tensions_n[(TIME_S >= 5.0) & (TIME_S <= 8.0), 2] = channel.tension_n(417.0)
    point = calibration_point(load(TimeWindow(5.0, 8.0)), as_recorded, recording(tensions_n))
    assert point.raw == pytest.approx(417.0)
    assert calibration_point(load(417.0), PACKED, None).raw == 417.0


@pytest.mark.parametrize("window", [TimeWindow(5.0, 5.2), TimeWindow(30.0, 40.0)])
def test_a_window_with_too_few_samples_is_refused(window):
    with pytest.raises(CommissioningError, match=r"line 2: only .* samples of run"):
        calibration_point(load(window), PACKED, recording(np.zeros((200, 12))))


def test_a_window_wants_a_recording():
    with pytest.raises(CommissioningError, match="give the recording as well"):
        calibration_point(load(TimeWindow(1.0, 2.0)), PACKED, None)


POINTS = [CalibrationPoint(force, 3.0 + 4.0 * force) for force in (0.0, 20.0, 40.0, 60.0, 80.0)]


def test_the_record_is_taken_by_the_map_it_was_made_for():
    found = {"cable_9": calibrate_sensor("cable_9", POINTS, 0.01)}
    made = calibration_record(
        found, PACKED, PACKED_DATABASE, datetime(2026, 3, 1, tzinfo=UTC), 9.81, 0.01
    )
    assert set(made.uncalibrated) == set(PACKED.channels) - {"cable_9"}
    assert made.cables["cable_9"].signal == PACKED.channels["cable_9"].signal
    assert made.cables["cable_9"].points == 5
    assert made.cables["cable_9"].hysteresis_n is None
    assert made.cables["cable_9"].largest_force_n == 80.0
    channel = calibrated(PACKED, PACKED_DATABASE, made, "c").channels["cable_9"]
    assert abs(channel.tension_n(3.0 + 4.0 * 50.0) - 50.0) < 1e-9
