"""The course of Fig. 9: from rest, through -10, 0, 10 and 0 degrees, the same every period."""

import numpy as np

from cablesense_paper.joint_course import PERIOD_S, course_rad

QUARTER_S = 0.25 * PERIOD_S


def test_it_goes_through_the_papers_four_angles():
    angles = course_rad(PERIOD_S + QUARTER_S * np.arange(1.0, 5.0), [0], 2)
    np.testing.assert_allclose(np.rad2deg(angles[:, 0]), [-10.0, 0.0, 10.0, 0.0], atol=1e-9)


def test_it_begins_at_rest():
    angles = course_rad(np.array([0.0, 1e-3]), [0], 1)
    assert np.abs(angles).max() < 1e-9


def test_it_is_the_same_every_period_and_moves_no_other_joint():
    time_s = np.linspace(PERIOD_S, 2.0 * PERIOD_S, 20)
    angles = course_rad(time_s, [0, 2], 4)
    np.testing.assert_allclose(course_rad(time_s + PERIOD_S, [0, 2], 4), angles, atol=1e-12)
    assert not angles[:, [1, 3]].any()
    np.testing.assert_array_equal(angles[:, 0], angles[:, 2])
