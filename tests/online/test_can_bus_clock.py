"""Bus timestamps: kept when they are of this machine's clock, carried over when they are not."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_online.can.bus import BusClock

NOW_S = 1.7e9


def test_stamps_of_this_machines_clock_are_kept():
    clock = BusClock()
    for number in range(100):
        stamp_s = NOW_S + number * 1e-3
        late_s = 0.03 if number % 7 == 0 else 1e-4
        assert clock.time_s(stamp_s, stamp_s + late_s) == stamp_s


def test_an_adapters_own_clock_is_carried_over_and_its_drift_followed():
    rng, clock, error_s = np.random.default_rng(0), BusClock(), []
    for number in range(20_000):
        true_s = number * 1e-2
        stamp_s = 12.0 + true_s * (1.0 + 100e-6)
        arrival_s = NOW_S + true_s + 1e-4 + rng.exponential(1e-3)
        error_s.append(clock.time_s(stamp_s, arrival_s) - (NOW_S + true_s))
    assert np.abs(error_s[100:]).max() < 2e-3
    assert np.std(error_s[100:]) < 0.5e-3  # not the millisecond by which arrival is scattered


@pytest.mark.parametrize("stamp_s", [0.0, -1.0, math.nan, math.inf])
def test_without_a_usable_stamp_a_frame_counts_from_arrival(stamp_s):
    assert BusClock().time_s(stamp_s, NOW_S) == NOW_S


def test_a_clock_that_was_set_is_noticed():
    clock = BusClock()
    clock.time_s(500.0, NOW_S)
    assert clock.time_s(1.0, NOW_S + 1.0) == pytest.approx(NOW_S + 1.0)
    assert clock.time_s(NOW_S + 2.0, NOW_S + 2.0) == pytest.approx(NOW_S + 2.0)


def test_a_restart_forgets_the_clock():
    clock = BusClock()
    clock.time_s(500.0, NOW_S)
    clock.restart()
    assert clock.time_s(499.5, NOW_S + 1.0) == pytest.approx(NOW_S + 1.0)


@given(st.lists(st.floats(allow_nan=True, allow_infinity=True), max_size=50))
def test_any_stamps_give_finite_times(stamps_s):
    clock = BusClock()
    for number, stamp_s in enumerate(stamps_s):
        assert math.isfinite(clock.time_s(stamp_s, NOW_S + number))
