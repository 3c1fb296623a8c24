"""Courses of set-points: within reach, smooth, and the same for the same seed.

A motion protocol that cannot be is refused, naming what would be right.
"""

import numpy as np
import pytest

from cablesense_training.data.motion_protocol import (
    STEP_S,
    MotionProtocol,
    drawn_contacts,
    drawn_motion,
)
from cablesense_training.errors import DatasetError

PROTOCOL = MotionProtocol(duration_s=12.0)


@pytest.fixture(scope="module")
def motion():
    return drawn_motion(PROTOCOL, 8, np.random.default_rng(3))


def test_it_stays_within_the_range_but_for_a_little_overshoot(motion):
    assert np.abs(np.rad2deg(motion.angle_rad)).max() < 1.1 * PROTOCOL.pose_range_deg
    assert np.abs(np.rad2deg(motion.speed_rad_s)).max() < 1.3 * PROTOCOL.joint_speed_deg_s


def test_speeds_are_those_of_the_fine_course(motion):
    fine = motion.fine_rad.reshape(-1, 8)
    inner = motion.fine_rad.shape[1]
    speed = np.gradient(fine, STEP_S, axis=0)[inner - 1 :: inner]
    moved = np.abs(speed - motion.speed_rad_s)[:-1]
    assert np.quantile(moved, 0.99) < 0.02
    np.testing.assert_array_equal(motion.angle_rad, fine[inner - 1 :: inner])


def test_a_seed_is_a_course():
    again = [drawn_motion(PROTOCOL, 8, np.random.default_rng(s)).angle_rad for s in (5, 5, 6)]
    np.testing.assert_array_equal(again[0], again[1])
    assert not np.array_equal(again[0], again[2])


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("sequences", 0),
        ("duration_s", float("nan")),
        ("tick_s", 0.0),
        ("pose_range_deg", 90.0),
        ("joint_speed_deg_s", float("inf")),
        ("force_high_n", -1.0),
        ("tare_samples", 0),
    ],
)
def test_a_value_out_of_range_is_refused(name, value):
    with pytest.raises(DatasetError, match=rf"{name} = .*: must be "):
        MotionProtocol(**{name: value})


CONTACTS = MotionProtocol(duration_s=200.0, force_high_n=80.0)


def test_free_ticks_have_no_force_and_contacts_stay_within_the_range():
    contact = drawn_contacts(CONTACTS, 4, np.random.default_rng(0))
    free = contact.segment == 0
    assert 0.2 < free.mean() < 0.8
    assert (contact.magnitude_n[free] == 0.0).all()
    assert (contact.magnitude_n >= 0.0).all()
    assert 40.0 < contact.magnitude_n.max() <= 80.0
    assert set(contact.segment) == {0, 1, 2, 3, 4}
    assert ((contact.angle_deg >= 0.0) & (contact.angle_deg < 360.0)).all()


def test_a_contact_rises_from_nothing_and_ends_in_nothing():
    contact = drawn_contacts(CONTACTS, 4, np.random.default_rng(1))
    starts = np.flatnonzero((contact.segment[1:] > 0) & (contact.segment[:-1] == 0)) + 1
    peak = contact.magnitude_n.max()
    assert np.median(contact.magnitude_n[starts]) < 0.5 * peak
    changes = (contact.segment[1:] != contact.segment[:-1]) & (contact.segment[1:] > 0)
    assert (contact.segment[:-1][changes] == 0).all()
