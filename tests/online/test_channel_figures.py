"""Noise, step and drift of one sensor come back as planted."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_online.commissioning.sensor_statistics import (
    channel_statistics,
    quantisation_step_n,
)

TIME_S = np.arange(2000) / 100.0
REST = np.ones(2000, dtype=bool)


def noise_n(deviation_n, seed=0):
    return np.random.default_rng(seed).normal(0.0, deviation_n, 2000)


def test_noise_is_told_beside_drift():
    figures = channel_statistics("c", TIME_S, 50.0 + 0.1 * TIME_S + noise_n(0.2), REST)
    assert figures.noise_n == pytest.approx(0.2, rel=0.05)
    assert figures.drift_n == pytest.approx(2.0, rel=0.05)
    assert figures.mean_n == pytest.approx(51.0, abs=0.05)


def test_only_what_was_read_at_rest_counts_as_noise():
    moving = 50.0 + noise_n(0.1) + np.where(TIME_S > 10.0, 40.0 * np.sin(20.0 * TIME_S), 0.0)
    figures = channel_statistics("c", TIME_S, moving, TIME_S <= 10.0)
    assert figures.noise_n == pytest.approx(0.1, rel=0.1)
    assert figures.highest_n > 85.0
    assert figures.mean_n == pytest.approx(50.0, abs=0.05)


def test_without_rest_noise_and_drift_are_not_told():
    figures = channel_statistics("c", TIME_S, 50.0 + noise_n(0.1), ~REST)
    assert (figures.noise_n, figures.drift_n) == (None, None)


@given(st.floats(1e-4, 1.0), st.floats(-100.0, 100.0), st.floats(1.0, 50.0))
def test_the_step_of_quantised_readings_is_found(step_n, start_n, spread_steps):
    true_n = np.random.default_rng(0).normal(0.0, spread_steps * step_n, 2000)
    read_n = start_n + step_n * np.round(true_n / step_n)
    assert quantisation_step_n(read_n) == pytest.approx(step_n, rel=1e-3)


def test_the_step_survives_rounding_in_a_file():
    true_n = 50.0 + 40.0 * np.sin(TIME_S)
    read_n = np.round(0.1813 * np.round(true_n / 0.1813), 4)
    assert quantisation_step_n(read_n) == pytest.approx(0.1813, abs=1e-3)


def test_three_neighbouring_values_at_rest_show_the_step():
    read_n = 0.18 * np.round((50.04 + noise_n(0.05)) / 0.18)
    assert len(np.unique(read_n)) == 3
    assert quantisation_step_n(read_n) == pytest.approx(0.18)


def test_readings_on_no_steps_have_none():
    assert quantisation_step_n(50.0 + noise_n(0.2)) is None
    assert quantisation_step_n(np.full(100, 3.0)) is None
