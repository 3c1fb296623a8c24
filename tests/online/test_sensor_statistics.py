"""Noise, step, drift and timing of tension readings, and movement under pulls."""

from dataclasses import replace

import numpy as np
import pytest
from gap_recordings import small_recording
from hypothesis import given
from hypothesis import strategies as st
from sensor_series import EXPECTED, RATE_HZ, good_tensions_n, series

from cablesense_base import CableSenseError
from cablesense_online.commissioning.sensor_statistics import (
    SETTLING_S,
    PullVerdict,
    at_rest_without,
    channel_statistics,
    judge_pull,
    quantisation_step_n,
    series_of,
    timing_statistics,
)
from cablesense_online.commissioning.tables import CommissioningError, Pull, TimeWindow

TIME_S = np.arange(2000) / 100.0
REST = np.ones(2000, dtype=bool)


def noise_n(deviation_n, seed=0):
    return np.random.default_rng(seed).normal(0.0, deviation_n, 2000)


def test_noise_is_estimated_beside_drift():
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


def test_without_rest_noise_and_drift_are_unknown():
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


def test_readings_on_no_steps_have_none():
    assert quantisation_step_n(50.0 + noise_n(0.2)) is None
    assert quantisation_step_n(np.full(100, 3.0)) is None


def at(time_s):
    return series(np.zeros((len(time_s), 12)), np.asarray(time_s))


@given(st.floats(1.0, 2000.0), st.sets(st.integers(1, 98), max_size=20))
def test_missing_samples_are_counted_and_do_not_lower_the_rate(rate_hz, missing):
    time_s = np.delete(np.arange(100) / rate_hz, sorted(missing))
    figures = timing_statistics(at(time_s))
    assert figures.rate_hz == pytest.approx(rate_hz, rel=1e-6)
    assert figures.lost == len(missing)
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


def test_a_handful_of_samples_is_refused():
    with pytest.raises(CommissioningError, match="only 10 samples; at least 21"):
        timing_statistics(at(np.arange(10.0)))


NAMES = tuple(f"cable_{n}" for n in range(1, 13))


def test_rest_is_the_usual_pose_without_a_load_once_settled():
    recording = small_recording()
    found = series_of(recording, NAMES)
    assert found.at_rest[:20].all()
    assert not found.at_rest[recording.load_segment > 0].any()
    assert not found.at_rest[recording.command_rad.any(axis=1)].any()
    unloading = np.flatnonzero(np.diff((recording.load_segment > 0).astype(int)) == -1)[0] + 1
    settled = recording.time_s > recording.time_s[unloading] + SETTLING_S
    assert not found.at_rest[unloading]
    assert found.at_rest[settled].any()


def test_a_pull_is_no_rest_nor_is_what_follows_at_once():
    found = series_of(small_recording(), NAMES)
    rest = at_rest_without(found, [Pull("cable_1", TimeWindow(1.0, 2.0))])
    assert rest[found.time_s < 1.0].all()
    assert not rest[(found.time_s >= 1.0) & (found.time_s <= 2.0 + SETTLING_S)].any()


WINDOW = TimeWindow(4.0, 7.0)


def judged(moves_n, dead=None, window=WINDOW):
    """What a pull of cable_3 shows that moves channels (from 0) by so much."""
    tensions_n = good_tensions_n()
    pulled = slice(int(4.5 * RATE_HZ), int(6.5 * RATE_HZ))
    for channel, move_n in moves_n.items():
        tensions_n[pulled, channel] += move_n
    if dead is not None:
        tensions_n[:, dead] = 50.0
    return judge_pull(series(tensions_n), Pull("cable_3", window), EXPECTED.floor_n)


def test_its_own_channel_moves_most():
    found = judged({2: 20.0, 4: -9.0})
    assert found.verdict is PullVerdict.RIGHT
    assert (found.moved, found.second) == ("cable_3", "cable_5")
    assert found.moved_n == pytest.approx(20.0, abs=0.5)


@pytest.mark.parametrize(
    ("moves_n", "dead", "verdict"),
    [
        ({4: 20.0, 2: -9.0}, None, PullVerdict.SWAPPED),
        ({4: 20.0}, None, PullVerdict.SWAPPED),
        ({4: 20.0}, 2, PullVerdict.DEAD),
        ({2: 20.0, 4: -18.0}, None, PullVerdict.UNCLEAR),
        ({4: 20.0, 2: 18.0}, None, PullVerdict.UNCLEAR),
        ({2: 0.3}, None, PullVerdict.TOO_WEAK),
    ],
)
def test_what_a_pull_shows(moves_n, dead, verdict):
    assert judged(moves_n, dead).verdict is verdict


@pytest.mark.parametrize("window", [TimeWindow(0.0, 2.0), TimeWindow(50.0, 60.0)])
def test_a_pull_without_readings_around_it_is_refused(window):
    with pytest.raises(CableSenseError, match="pull of cable_3 from"):
        judged({}, window=window)
