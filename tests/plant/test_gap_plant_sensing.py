"""What the plant's sensors make of tensions: scale, leak, lag, zeros, dropouts, noise and step."""

from dataclasses import replace

import numpy as np
import pytest

from cablesense_gap.plant.sensing import (
    Course,
    Filter,
    Freezing,
    Sensing,
    Wander,
    ideal_sensing,
    read_n,
)

TIME_S = 0.2 * np.arange(600)
TENSION = 50.0 + 20.0 * np.sin(0.05 * np.arange(600))[:, None] * np.array([1.0, 0.5, -1.0])
STEP = np.where(TIME_S < 20.0, 50.0, 80.0)[:, None] * np.ones(3)


def sensors(**changes: object) -> Sensing:
    return replace(ideal_sensing(3, 50.0), **changes)


def test_ideal_sensors_tell_the_truth() -> None:
    np.testing.assert_array_equal(sensors().signals_n(TENSION, TIME_S), TENSION)


def test_gain_leak_and_offset() -> None:
    leak = np.zeros((3, 3))
    leak[2, 0] = 0.1
    faulty = sensors(gain=np.array([1.1, 1.0, 1.0]), leak=leak, offset_n=np.array([0.0, 2.0, 0.0]))
    found = faulty.signals_n(TENSION, TIME_S)
    np.testing.assert_allclose(found[:, 0], 1.1 * TENSION[:, 0])
    np.testing.assert_allclose(found[:, 1], TENSION[:, 1] + 2.0)
    np.testing.assert_allclose(found[:, 2], TENSION[:, 2] + 0.11 * TENSION[:, 0])


@pytest.mark.parametrize("kind", list(Filter))
def test_a_late_sensor_arrives_and_was_at_rest_before(kind: Filter) -> None:
    late = sensors(lag_s=np.array([1.0, 0.0, 2.5]), lag_filter=kind).signals_n(STEP, TIME_S)
    np.testing.assert_allclose(late[TIME_S < 19.9], 50.0)
    np.testing.assert_array_equal(late[:, 1], STEP[:, 1])
    np.testing.assert_allclose(late[-1], 80.0, atol=1e-6)
    below = (late < 79.9).sum(axis=0)
    assert below[1] < below[0] < below[2]
    assert (np.diff(late, axis=0) >= -1e-9).all()


@pytest.mark.parametrize("kind", list(Filter))
def test_a_ramp_is_followed_late_by_the_lag(kind: Filter) -> None:
    """Whatever the filter, a steady rise lags by its mean delay."""
    ramp = TIME_S[:, None] * np.ones(3)
    late = sensors(lag_s=np.array([1.0, 0.4, 3.0]), lag_filter=kind).signals_n(ramp, TIME_S)
    behind = TIME_S[-1] - late[-1]
    np.testing.assert_allclose(behind, [1.0, 0.4, 3.0], atol=0.02)


@pytest.mark.parametrize("course", list(Course))
def test_zeros_wander_within_their_size(course: Course) -> None:
    wander = Wander(np.array([1.5, 0.0, -0.5]), course, 60.0, 0.7, 4)
    zeros = wander.zeros_n(TIME_S)
    assert not zeros[:, 1].any()
    assert np.abs(zeros).max(axis=0) == pytest.approx([1.5, 0.0, 0.5], rel=0.15)
    np.testing.assert_array_equal(zeros, wander.zeros_n(TIME_S))
    assert np.abs(np.diff(zeros, axis=0)).max() < 0.4


def test_a_frozen_channel_repeats_its_last_value() -> None:
    freezing = Freezing(np.array([0.3, 0.0, 0.0]), 10.0, 2)
    held = freezing.held_n(TENSION)
    same = np.flatnonzero(np.diff(held[:, 0]) == 0.0)
    assert 0.1 < len(same) / len(held) < 0.5
    np.testing.assert_array_equal(held[:, 1:], TENSION[:, 1:])


def test_high_tensions_hit_the_ceiling_softly() -> None:
    found = sensors(ceiling_n=np.full(3, 60.0)).signals_n(STEP, TIME_S)
    assert (found[-1] > 60.0).all()
    assert (found[-1] < 70.0).all()
    np.testing.assert_array_equal(found[0], 50.0)


def test_readings_have_noise_and_whole_steps() -> None:
    rng = np.random.default_rng(0)
    signal = rng.uniform(10.0, 90.0, (50_000, 3))
    readings = read_n(signal, 0.05, 0.1813, rng)
    steps = readings / 0.1813
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    spread = np.sqrt(0.05**2 + 0.1813**2 / 12.0)
    assert (readings - signal).std() == pytest.approx(spread, rel=0.02)
