"""The jaw's transmission by the chain law: closed forms, planted truth, its inversion."""

import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from real_jaw_diagnosis import diagnose
from real_jaw_mechanism import (
    AT_DRIVE_NM,
    AT_JAW_NM,
    LIMIT,
    PRETENSION,
    RUN_RAD_NM,
    SPRING_NM_RAD,
    Transmission,
    beside_cables,
    problem_of,
    signs,
)
from real_jaw_physics import PhysicsEstimator
from real_jaw_recordings import JawRecording

FRICTION = {LIMIT: 0.4, RUN_RAD_NM: 0.4, PRETENSION: 0.005}
COULOMB = {AT_DRIVE_NM: 0.04}
NOISE_NM = 0.001


def followed(values, turned_rad, load_nm):
    """(T,) torque at the drive along a course."""
    transmission = Transmission([values], turned_rad[:1])
    torque = []
    for turned, load in zip(turned_rad, load_nm, strict=True):
        torque.append(transmission.rest(np.array([turned]), np.array([load]))[0][0])
        transmission.settle()
    return np.array(torque)


@cache
def planted(effects, levels=(20.0, 40.0, 60.0, 80.0)):
    """Two periods at 0.5 Hz against each load, of a transmission with known numbers."""
    values = {**dict(effects), SPRING_NM_RAD: 0.02}
    rng = np.random.default_rng(1)
    angle = 0.5 + 0.5 * np.cos(np.pi * np.arange(0.0, 4.0, 0.01))
    recordings = []
    for level in levels:
        load = 1e-3 * level * (1.2 - 0.2 * angle)
        torque = followed(values, -angle, load) + beside_cables([values], -angle[None])[0]
        torque += rng.normal(0.0, NOISE_NM, len(torque))
        recordings.append(
            JawRecording(f"at_{level:g}", "a", 0.5, level, angle, torque, torque, angle, -load)
        )
    return recordings


def test_without_friction_the_drive_carries_the_load():
    rng = np.random.default_rng(0)
    turned, load = rng.uniform(-0.5, 0.5, 30), rng.uniform(0.0, 0.2, 30)
    np.testing.assert_allclose(followed({}, turned, load), load, atol=3e-6)


def test_a_cable_that_slips_alone_is_a_capstan():
    turned = np.concatenate([np.linspace(0.0, 1.0, 50), np.linspace(1.0, 0.0, 50)])
    torque = followed({LIMIT: 0.4, PRETENSION: 1e-6}, turned, np.full(100, 0.1))
    assert torque[49] == pytest.approx(0.1 * np.exp(0.4), rel=1e-4)
    assert torque[-1] == pytest.approx(0.1 * np.exp(-0.4), rel=1e-4)


def test_a_run_that_sticks_hides_how_the_load_grows():
    wound_up = np.array([0.0, 0.5, 1.0, 1.0, 1.0, 1.0])
    torque = followed(FRICTION, wound_up, np.array([0.1, 0.1, 0.1, 0.12, 0.14, 0.11]))
    np.testing.assert_allclose(torque[2:], 0.1 * np.exp(0.4), rtol=1e-3)
    np.testing.assert_allclose(torque[2:], torque[2], rtol=1e-12)


def test_what_the_drive_shows_of_a_load_is_the_slope():
    transmission = Transmission([{**FRICTION, AT_JAW_NM: 0.005}], np.zeros(1))
    for turned in np.linspace(0.0, 1.0, 20):
        at = np.array([turned])
        below, above = (transmission.rest(at, np.array([0.1 + d]))[0] for d in (-1e-4, 1e-4))
        _, slope = transmission.rest(at, np.array([0.1]))
        transmission.settle()
    assert slope == pytest.approx((above - below) / 2e-4, rel=1e-3)
    assert slope == pytest.approx(np.exp(0.4), rel=1e-2)


@pytest.mark.slow
def test_a_mirrored_tool_has_other_signs_and_the_same_problem():
    recordings = planted(tuple(FRICTION.items()))
    mirrored = [
        JawRecording(
            r.name, r.tool, r.frequency_hz, r.brake_percent,
            -r.drive_angle_rad, r.drive_torque_nm, r.motor_current_a, r.jaw_angle_rad,
            -r.jaw_torque_nm,
        )
        for r in recordings
    ]  # fmt: skip
    assert signs(recordings) == (-1.0, -1.0)
    assert signs(mirrored) == (1.0, 1.0)
    one, other = problem_of(recordings), problem_of(mirrored)
    np.testing.assert_allclose(one.nominal, other.nominal, atol=1e-9)
    np.testing.assert_array_equal(one.readings, other.readings)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("truth", "effects"),
    [
        (FRICTION, ("capstan_friction",)),
        (COULOMB, ("coulomb_friction",)),
        (FRICTION | COULOMB, ("capstan_friction", "coulomb_friction")),
        ({}, ("none",)),
    ],
)
def test_the_planted_friction_is_named(truth, effects):
    best = diagnose(problem_of(planted(tuple(truth.items()))))[0]
    assert best.effects == effects
    assert best.hypothesis is not None
    for term, value in best.hypothesis.values.items():
        if term in (LIMIT, AT_DRIVE_NM):
            assert value == pytest.approx(truth[term], rel=0.1)


@pytest.mark.slow
def test_the_filter_inverts_the_transmission_that_it_was_fitted_to():
    recordings = planted(tuple((FRICTION | COULOMB).items()))
    estimator = PhysicsEstimator(recordings)
    for recording, told in zip(recordings, estimator.torques_nm(recordings), strict=True):
        error = (told - recording.jaw_torque_nm)[150:]
        assert np.sqrt((error**2).mean()) < 0.05 * np.abs(recording.jaw_torque_nm).mean()
