"""Simulated time keeps to real time and never runs after it for long."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cablesense_online.simulated_arm import RealTimePacer


def test_keeps_pace_over_uneven_ticks():
    pacer = RealTimePacer(1e-3, 0.1, 5.0)
    total = sum(pacer.steps_due(5.0 + t) for t in (0.0101, 0.0199, 0.0305, 0.0305, 0.1))
    assert total == 100
    assert pacer.real_time_factor(5.1) == pytest.approx(1.0)
    assert pacer.skipped_s == 0.0


def test_a_long_pause_is_let_go_and_counted():
    pacer = RealTimePacer(1e-3, 0.1, 0.0)
    assert pacer.steps_due(2.0) == 100
    assert pacer.skipped_s == pytest.approx(1.9)
    assert pacer.steps_due(2.01) == 10
    assert pacer.real_time_factor(2.01) == pytest.approx(0.11 / 2.01)


@given(st.lists(st.floats(0.0, 10.0), max_size=50))
def test_never_more_than_the_longest_lag_at_once(waits):
    pacer, now = RealTimePacer(1e-3, 0.1, 0.0), 0.0
    for wait in waits:
        now += wait
        assert 0 <= pacer.steps_due(now) <= 100
