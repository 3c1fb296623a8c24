"""Contacts along a course: one at a time, with pauses, as strong as the protocol says."""

import numpy as np

from cablesense_training.motion.motion_protocol import MotionProtocol, drawn_contacts

PROTOCOL = MotionProtocol(duration_s=200.0, force_high_n=80.0)


def test_free_ticks_have_no_force_and_contacts_stay_within_the_range():
    course = drawn_contacts(PROTOCOL, 4, np.random.default_rng(0))
    free = course.segment == 0
    assert 0.2 < free.mean() < 0.8
    assert (course.magnitude_n[free] == 0.0).all()
    assert (course.magnitude_n >= 0.0).all()
    assert 40.0 < course.magnitude_n.max() <= 80.0
    assert set(course.segment) == {0, 1, 2, 3, 4}
    assert ((course.angle_deg >= 0.0) & (course.angle_deg < 360.0)).all()


def test_a_contact_rises_from_nothing_and_ends_in_nothing():
    course = drawn_contacts(PROTOCOL, 4, np.random.default_rng(1))
    starts = np.flatnonzero((course.segment[1:] > 0) & (course.segment[:-1] == 0)) + 1
    peak = course.magnitude_n.max()
    assert np.median(course.magnitude_n[starts]) < 0.5 * peak
    changes = (course.segment[1:] != course.segment[:-1]) & (course.segment[1:] > 0)
    assert (course.segment[:-1][changes] == 0).all()
