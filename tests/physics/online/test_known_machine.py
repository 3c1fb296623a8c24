"""Readings as arrays: an arm is tared, pushed, and what is said of it holds."""

from __future__ import annotations

import numpy as np
import pytest

from cablesense_contact.calibration import CalibrationError
from cablesense_contact.errors import ModelFileError
from cablesense_contact.judgement import ContactState
from cablesense_online import KnownMachine
from cablesense_online.samples import SampleError
from cablesense_sim import mechanism_of, normal_force_n, open_arm, solve_equilibrium

POSE_RAD = np.deg2rad([5.0, 0.0, -5.0, 3.0, 0.0, 0.0, 2.0, -4.0])


@pytest.fixture(scope="module")
def pushed():
    """Tensions of the untouched arm, and under 20 N on segment 3."""
    mechanism = mechanism_of(open_arm("cdsm_lab"))
    push_n = normal_force_n(mechanism, POSE_RAD, segment=3, angle_deg=215.0, magnitude_n=20.0)
    loads_n = [np.zeros_like(push_n), push_n]
    return solve_equilibrium(mechanism, [POSE_RAD, POSE_RAD], loads_n).tensions_n


@pytest.fixture(scope="module")
def tared(pushed):
    return KnownMachine.load("cdsm_lab").tared(pushed[0], POSE_RAD)


def test_a_push_is_within_its_intervals(tared, pushed):
    touch = tared.touch(pushed[1], POSE_RAD)
    assert touch.state is ContactState.CONTACT
    assert touch.link == "segment_3"
    low_n, high_n = touch.magnitude_ci95_n
    assert low_n < 20.0 < high_n
    assert touch.angle_deg == pytest.approx(215.0, abs=1.0)
    low_m, high_m = touch.place_ci95_m
    assert low_m < mechanism_of(open_arm("cdsm_lab")).contact_m[2] < high_m


def test_a_batch_says_what_single_readings_say(tared, pushed):
    free, touched = tared.touches(pushed, np.stack([POSE_RAD, POSE_RAD]))
    assert free.state is ContactState.FREE
    assert str(free) == "free"
    assert str(touched) == str(tared.touch(pushed[1], POSE_RAD))


def test_of_segment_1_it_says_the_moment(tared):
    mechanism = mechanism_of(open_arm("cdsm_lab"))
    push_n = normal_force_n(mechanism, POSE_RAD, segment=1, angle_deg=90.0, magnitude_n=20.0)
    reading_n = solve_equilibrium(mechanism, POSE_RAD, push_n).tensions_n
    touch = tared.touch(reading_n, POSE_RAD)
    assert touch.state is ContactState.MOMENT
    moment_n_m = 20.0 * mechanism.contact_m[0]
    assert np.hypot(*touch.moment_n_m) == pytest.approx(moment_n_m, rel=0.05)
    assert str(touch).startswith(f"moment on segment_1: {moment_n_m:.1f}")


def test_a_tare_narrows_what_is_stated(pushed):
    by_tolerances = KnownMachine.load("cdsm_lab")
    widths_n = []
    for known in (by_tolerances, by_tolerances.tared(pushed[0], POSE_RAD)):
        low_n, high_n = known.touch(pushed[1], POSE_RAD).magnitude_ci95_n
        widths_n.append(high_n - low_n)
    assert widths_n[1] < widths_n[0]


def test_a_touched_arm_is_no_tare(tared, pushed):
    with pytest.raises(CalibrationError, match="not those of the untouched arm"):
        tared.tared(pushed[1], POSE_RAD)


def test_a_wrong_channel_has_no_link_and_is_named(tared, pushed):
    reading_n = pushed[0].copy()
    reading_n[4] += 20.0
    touch = tared.touch(reading_n, POSE_RAD)
    assert touch.state is ContactState.IMPLAUSIBLE
    assert touch.link == ""
    assert touch.doubt == "cable_5 reads 19.9 N too much, and nothing touches the arm"
    assert touch.doubt in str(touch)


def test_a_network_of_the_paper_takes_no_tare():
    with pytest.raises(ModelFileError, match="export"):
        KnownMachine.load("cdsm", "peers/cdsm_two_stage")


def test_a_reading_that_no_cable_gives_is_refused_and_named():
    arm = KnownMachine.load("cdsm_lab")
    readings_n = np.full((2, 12), 50.0)
    readings_n[1, 4] = 25_000.0
    with pytest.raises(SampleError, match=r"reading 2 of 2: effort of cable_5 is 25000 N"):
        arm.touches(readings_n, np.zeros((2, 8)))
