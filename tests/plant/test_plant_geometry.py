"""Where the plant's holes are, and how its cables lengthen and bend."""

from dataclasses import replace

import numpy as np
import pytest
from plant_arm import BODY, NOMINAL

from cablesense_plants.arm.body import Body, CableContact
from cablesense_plants.arm.geometry import cable_lengths_m, frames, spans, turns

JOINTS = 2 * NOMINAL.segment_count
RNG = np.random.default_rng(0)
ANGLES = RNG.uniform(-0.2, 0.2, (5, JOINTS))


def lengths(body: Body, angles: np.ndarray) -> np.ndarray:
    return spans(body, angles, turns(body, angles)).length_m


def test_the_straight_arm_is_straight() -> None:
    straight = np.zeros((1, JOINTS))
    np.testing.assert_allclose(lengths(BODY, straight)[0, 0], 0.03)
    assert (lengths(BODY, straight)[0, 1, :3] == 0.0).all()  # segment 1's cables have ended
    placed = frames(BODY, straight, turns(BODY, straight))
    np.testing.assert_allclose(placed.centre_m[0, :, 0], 0.015 + 0.13 * np.arange(4))


@pytest.mark.parametrize("angle", [-0.3, 0.1])
def test_a_span_in_the_plane_of_bending_has_its_closed_form(angle: float) -> None:
    """The hole at +z when a joint pitches: the law of cosines about the joint's centre."""
    angles = np.zeros((1, JOINTS))
    angles[0, 0] = angle
    offset, radius = 0.015, 0.05
    half = np.arctan2(offset, radius)
    # the plates open by the pitch on the side of +z when the arm pitches down, and close above
    expected = 2.0 * np.hypot(offset, radius) * np.sin(half + 0.5 * angle)
    assert lengths(BODY, angles)[0, 0, 0] == pytest.approx(expected, rel=1e-12)


def test_slopes_and_curves_are_derivatives() -> None:
    found = spans(BODY, ANGLES, turns(BODY, ANGLES))
    step = 1e-5
    for joint in range(4):
        for axis in range(2):
            moved = np.zeros(JOINTS)
            moved[2 * joint + axis] = step
            ahead = spans(BODY, ANGLES + moved, turns(BODY, ANGLES + moved))
            back = spans(BODY, ANGLES - moved, turns(BODY, ANGLES - moved))
            slope = (ahead.length_m - back.length_m)[:, joint] / (2 * step)
            np.testing.assert_allclose(found.slope_m_rad[:, joint, axis], slope, atol=1e-9)
            curve = (ahead.slope_m_rad - back.slope_m_rad)[:, joint] / (2 * step)
            own = found.curve_m_rad2[:, joint, axis : axis + 2]
            np.testing.assert_allclose(own, curve, atol=1e-8)


def test_a_contact_of_cables_lengthens_them_beyond_its_angle_alone() -> None:
    contact = CableContact(
        joint=1, toward=(0.0, -1.0), cables=(4, 7), depth_m_rad2=0.02, from_rad=0.05
    )
    touching = replace(BODY, cable_contacts=(contact,))
    angles = np.zeros((2, JOINTS))
    angles[:, 3] = [0.15, -0.15]
    more = cable_lengths_m(touching, angles) - cable_lengths_m(BODY, angles)
    assert not more[0].any()
    np.testing.assert_allclose(more[1, [4, 7]], 0.02 * 0.1**2)
    assert np.count_nonzero(more[1]) == 2


def test_a_cable_bends_by_half_the_pitch_at_either_plate() -> None:
    angles = np.zeros((1, JOINTS))
    angles[0, 0] = 0.2
    bends = spans(BODY, angles, turns(BODY, angles), with_bends=True).bend_rad[0]
    np.testing.assert_allclose(bends[0, :, 3:], 0.1)
    assert not bends[1:].any()
    assert (bends[0, 1, :3] == 0.0).all()  # anchored behind the first joint: no guide there
