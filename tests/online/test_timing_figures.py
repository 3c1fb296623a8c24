"""Rate, jitter and lost samples, of stamps alone."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sensor_series import series

from cablesense_online.commissioning.sensor_statistics import timing_statistics
from cablesense_online.commissioning.tables import CommissioningError


def at(time_s):
    return series(np.zeros((len(time_s), 12)), np.asarray(time_s))


@given(st.floats(1.0, 2000.0), st.sets(st.integers(1, 98), max_size=20))
def test_missing_samples_are_counted_and_do_not_lower_the_rate(rate_hz, missing):
    time_s = np.delete(np.arange(100) / rate_hz, sorted(missing))
    figures = timing_statistics(at(time_s))
    assert figures.rate_hz == pytest.approx(rate_hz, rel=1e-6)
    assert figures.lost == len(missing)
    assert figures.lost_share == pytest.approx(len(missing) / 100)
    assert figures.jitter_s < 1e-6 / rate_hz


def test_jitter_is_what_intervals_differ_by():
    time_s = np.arange(1000) / 100.0
    time_s[1::2] += 0.002
    assert timing_statistics(at(time_s)).jitter_s == pytest.approx(0.004, abs=1e-4)


def test_a_wanted_break_is_no_loss():
    time_s = np.concatenate([np.arange(50), 500.0 + np.arange(50)]) / 100.0
    broken = replace(at(time_s), block=np.repeat([0, 1], 50))
    assert timing_statistics(broken).lost == 0
    assert timing_statistics(at(time_s)).lost == 450


def test_a_handful_of_samples_tells_nothing():
    with pytest.raises(CommissioningError, match="only 10 samples; at least 21"):
        timing_statistics(at(np.arange(10.0)))
