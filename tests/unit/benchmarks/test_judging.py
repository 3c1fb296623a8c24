"""Statements about contacts are judged as the benchmarks say: by force, segment and moment."""

import numpy as np
import pytest
from judging import Acting, Stated, error_n, is_wrong, judged, misleads

from cablesense_plants.arm.built import Push
from cablesense_sim.rotations import rotation_matrix

LENGTH_M = np.full(4, 0.13)
STRAIGHT = np.tile(np.eye(3), (4, 1, 1))


def push(segment, place_m, force_n, axes=STRAIGHT):
    return Push(segment, place_m, axes[segment - 1] @ np.array(force_n, dtype=float))


def acting(*pushes, axes=STRAIGHT):
    return Acting(pushes, axes, LENGTH_M)


def stated(segment, place_m, lateral_n, *, only_moment=False, region_m=None):
    """A contact, or its moment alone, with the moment that it has about its joint."""
    along_m = 0.13 * (segment - 1) + place_m
    y, z = lateral_n
    return Stated(
        segment=segment,
        only_moment=only_moment,
        place_m=place_m,
        lateral_n=np.array([y, z]),
        moment_n_m=place_m * np.array([-z, y]),
        region_m=np.array(region_m or (along_m, along_m)),
        interval_n=np.array([0.0, 200.0]),
    )


def bent():
    """Axes of an arm each of whose joints is turned by 10 degrees about both axes across it."""
    turn = rotation_matrix(np.deg2rad([0.0, 10.0, 10.0]))
    return np.array([np.linalg.matrix_power(turn, n) for n in range(1, 5)])


@pytest.mark.parametrize(
    ("true_n", "said_n", "wrong"),
    [(10.0, 14.0, False), (10.0, 16.0, True), (100.0, 118.0, False), (100.0, 122.0, True)],
)
def test_a_force_is_wrong_if_it_is_off_by_more_than_5_n_and_a_fifth(true_n, said_n, wrong):
    under = acting(push(3, 0.06, [1.0, 0.0, true_n]))
    said = stated(3, 0.06, (0.0, said_n))
    assert judged(under, said).wrong is wrong
    assert error_n(under, said) == pytest.approx(said_n - true_n)


def test_a_force_of_another_direction_is_wrong():
    under = acting(push(3, 0.06, [0.0, 0.0, 10.0]))
    assert is_wrong(under, stated(3, 0.06, (10.0, 0.0)))


def test_next_to_a_joint_the_end_of_the_neighbour_is_the_same_place():
    under = acting(push(3, 0.005, [0.0, 0.0, 10.0]))
    assert not is_wrong(under, stated(2, 0.12, (0.0, 10.0)))
    elsewhere = stated(2, 0.06, (0.0, 10.0))
    assert is_wrong(under, elsewhere)
    assert error_n(under, elsewhere) == pytest.approx(10.0)
    # or the interval of the place says that it may be there
    assert not is_wrong(under, stated(2, 0.06, (0.0, 10.0), region_m=(0.18, 0.27)))


def test_a_force_is_compared_along_the_axes_of_the_stated_segment():
    axes = bent()
    force_n = np.array([0.0, 0.0, 40.0])
    under = acting(push(3, 0.005, force_n, axes), axes=axes)
    there_n = axes[1].T @ axes[2] @ force_n
    assert not is_wrong(under, stated(2, 0.128, tuple(there_n[1:])))
    assert np.hypot(*(there_n[1:] - force_n[1:])) < 0.3 * 40.0


def test_a_moment_is_judged_over_the_length_of_its_segment_wherever_on_it_the_contact_is():
    under = acting(push(2, 0.0025, [0.0, 0.0, 17.0]))
    # its place, which it does not state, is far from the contact
    moment_n_m = 17.0 * 0.1325
    said = stated(1, 0.047, (0.0, moment_n_m / 0.047), only_moment=True)
    assert not is_wrong(under, said)
    assert error_n(under, said) == pytest.approx(0.0, abs=1e-9)
    twice = stated(1, 0.094, (0.0, moment_n_m / 0.047), only_moment=True)
    assert is_wrong(under, twice)
    assert error_n(under, twice) == pytest.approx(moment_n_m / 0.13)


def test_a_moment_about_the_joint_of_another_segment_is_wrong():
    under = acting(push(4, 0.06, [0.0, 0.0, 2.0]))
    moment_n_m = under.moment_n_m(1)
    said = stated(1, 0.1, (moment_n_m[1] / 0.1, -moment_n_m[0] / 0.1), only_moment=True)
    assert error_n(under, said) == pytest.approx(0.0, abs=1e-9)
    assert is_wrong(under, said)


def test_one_contact_stated_of_two_misleads_unless_it_is_one_of_them():
    under = acting(push(1, 0.1, [0.0, 0.0, 20.0]), push(2, 0.06, [0.0, 0.0, 20.0]))
    assert not misleads(under, stated(2, 0.065, (0.0, 22.0)))
    assert misleads(under, stated(2, 0.03, (0.0, 35.0)))
    assert misleads(under, stated(2, 0.065, (20.0, 0.0)))
    # of several the place alone tells which of them is meant
    assert misleads(under, stated(2, 0.1, (0.0, 20.0)))


def test_a_moment_stated_of_two_contacts_is_that_of_both():
    under = acting(push(1, 0.1, [0.0, 0.0, 20.0]), push(2, 0.06, [0.0, 0.0, 20.0]))
    of_both_n_m = 20.0 * 0.1 + 20.0 * 0.19
    assert not misleads(under, stated(1, 0.1, (0.0, of_both_n_m / 0.1), only_moment=True))
    assert misleads(under, stated(1, 0.1, (0.0, 20.0), only_moment=True))


@pytest.mark.parametrize(("said_n", "wrong"), [(4.0, False), (6.0, True)])
def test_a_contact_on_an_untouched_arm_is_wrong_above_5_n(said_n, wrong):
    assert misleads(acting(), stated(3, 0.06, (0.0, said_n))) is wrong
    moment = stated(1, 0.13, (0.0, said_n), only_moment=True)
    assert misleads(acting(), moment) is wrong
    assert error_n(acting(), moment) == pytest.approx(said_n)


def test_moments_are_about_the_joints_of_the_bent_arm():
    axes = bent()
    load = push(3, 0.06, [1.0, 3.0, 10.0], axes)
    under = acting(load, axes=axes)
    point_m = 0.13 * (axes[0][:, 0] + axes[1][:, 0]) + 0.06 * axes[2][:, 0]
    expected_n_m = axes[0].T @ np.cross(point_m, load.force_n)
    np.testing.assert_allclose(under.moment_n_m(1), expected_n_m[1:], atol=1e-12)
    np.testing.assert_allclose(under.moment_n_m(3), [-0.6, 0.18], atol=1e-12)
    np.testing.assert_allclose(under.moment_n_m(4), 0.0, atol=1e-12)
