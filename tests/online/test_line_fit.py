"""A line through readings of known forces: exact, weighted, scaled, and as unsure as it says."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from cablesense_online.commissioning.sensor_calibration import fit_line

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


def test_readings_that_stand_still_have_no_line():
    assert fit_line(FORCES_N, np.full(6, 17.0), NONE, NONE) is None


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


def test_the_residual_is_in_newtons_of_the_sensor():
    raw = 100.0 - 4.0 * FORCES_N
    raw[2] += 8.0
    line = fit_line(FORCES_N, raw, NONE, np.where(np.arange(6) == 2, 1e4, 1.0))
    assert line.residual_n[2] == pytest.approx(-2.0, rel=1e-3)


@given(st.floats(0.01, 1.0), st.floats(1.0, 500.0))
def test_uncertainties_scale_with_the_units(noise, factor):
    raw = 7.0 + 3.0 * FORCES_N + noise * np.array([1.0, -1.0, 0.5, -0.5, 1.0, -0.5])
    line = fit_line(FORCES_N, raw, NONE, NONE)
    other = fit_line(FORCES_N, factor * raw, NONE, NONE)
    assert other.zero_u == pytest.approx(factor * line.zero_u, rel=1e-6)
    assert other.scale_u_n_per_unit == pytest.approx(line.scale_u_n_per_unit / factor, rel=1e-6)
    assert other.force_u_n(50.0) == pytest.approx(line.force_u_n(50.0), rel=1e-6)
    assert line.force_u_n(50.0) < line.force_u_n(0.0)
