"""Where a joint's position leaps: a trial follows another one without a pause."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cablesense_recording.channel_checks import position_leaps

ROWS = 1200
RATE_HZ = 100.0
SPANS = st.floats(0.01, 30.0)
SEEDS = st.integers(0, 1000)


def smooth_motion(seed, span, noise=0.0):
    """(R, 2) of two joints, each with three sines of up to 1.2 Hz."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(ROWS) / RATE_HZ
    frequency_hz = rng.uniform(0.1, 1.2, (3, 2))
    phase = rng.uniform(0.0, 2.0 * np.pi, (3, 2))
    position = np.sin(2.0 * np.pi * frequency_hz * time_s[:, None, None] + phase).sum(axis=1)
    position *= span / np.ptp(position, axis=0)
    return position + rng.normal(0.0, noise * span, position.shape)


@settings(max_examples=50, deadline=None)
@example(seed=79, span=1.0, share=0.0625, noise=0.0, row=20)  # the motion has nine peaks in all
@given(
    seed=SEEDS,
    span=SPANS,
    share=st.floats(0.025, 1.0),
    noise=st.sampled_from([0.0, 1e-4, 2e-4]),
    row=st.integers(20, ROWS - 20),
)
def test_a_leap_of_a_fortieth_of_the_span_is_found_in_its_row(seed, span, share, noise, row):
    position = smooth_motion(seed, span, noise)
    position[row:, 1] += share * span
    leap = position_leaps(position, np.zeros(ROWS, dtype=np.int64))
    np.testing.assert_array_equal(np.flatnonzero(leap), [row])


@settings(max_examples=50, deadline=None)
@given(seed=SEEDS, span=SPANS, noise=st.sampled_from([0.0, 1e-4, 1e-3, 1e-2]))
def test_smooth_motion_has_no_leap(seed, span, noise):
    position = smooth_motion(seed, span, noise)
    assert not position_leaps(position, np.zeros(ROWS, dtype=np.int64)).any()


@settings(max_examples=50, deadline=None)
@given(seed=SEEDS, row=st.integers(20, ROWS - 20), factor=st.floats(-2.0, 2.0))
def test_a_joint_that_is_hit_does_not_leap(seed, row, factor):
    """Its speed changes from one row to the next, and its position goes on from where it is."""
    position = smooth_motion(seed, 1.0)
    speed = np.diff(position, axis=0, prepend=position[:1])
    after = np.arange(ROWS) > row
    speed[after, 0] += factor * np.abs(speed[:, 0]).max()
    hit = position[0] + np.cumsum(speed, axis=0)
    assert not position_leaps(hit, np.zeros(ROWS, dtype=np.int64)).any()


@pytest.mark.parametrize("step", [0.002, 0.02])
def test_a_coarse_encoder_does_not_leap(step):
    position = np.round(smooth_motion(3, 1.0) / step) * step
    assert not position_leaps(position, np.zeros(ROWS, dtype=np.int64)).any()


def test_a_trial_may_begin_anywhere():
    position = smooth_motion(1, 1.0)
    position[600:] += 0.05
    assert not position_leaps(position, np.repeat([0, 1], 600)).any()


def test_motion_of_few_rows_has_no_leap():
    assert not position_leaps(smooth_motion(1, 1.0)[:8], np.zeros(8, dtype=np.int64)).any()
