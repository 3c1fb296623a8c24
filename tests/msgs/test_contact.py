"""A contact's force, its moment and its messages."""

from types import SimpleNamespace

import numpy as np
import pytest

from cablesense_msgs_py.topics import Frames
from cablesense_msgs_py.wrenches import (
    NO_CONTACT,
    Contact,
    describe_probabilities,
    put_contact_point,
    put_force_direction,
)

pytestmark = pytest.mark.filterwarnings(
    "ignore:module .sre_:DeprecationWarning"
)  # lark, of rosidl

FRAMES = Frames(4)


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 90.0, 200.0, 359.0])
def test_force_and_moment_are_those_of_a_push_at_the_contact_point(angle_deg):
    contact = Contact(2, angle_deg, 40.0, 0.065)
    assert np.linalg.norm(contact.force_n) == pytest.approx(40.0)
    assert np.degrees(np.arctan2(contact.force_n[1], contact.force_n[2])) % 360 == pytest.approx(
        angle_deg
    )
    np.testing.assert_allclose(
        contact.wrench[3:], np.cross([0.065, 0.0, 0.0], contact.force_n), atol=1e-12
    )


def test_no_contact_is_zero():
    assert not any(NO_CONTACT.wrench)


def test_point_and_direction_are_in_the_segments_frame():
    geometry_msgs = pytest.importorskip("geometry_msgs.msg")
    point, direction = geometry_msgs.PointStamped(), geometry_msgs.Vector3Stamped()
    contact = Contact(3, 90.0, 40.0, 0.065)
    put_contact_point(point, contact, FRAMES)
    put_force_direction(direction, contact, FRAMES)
    assert point.header.frame_id == direction.header.frame_id == "segment_3"
    assert point.point.x == 0.065
    assert direction.vector.y == pytest.approx(1.0)


def test_probabilities_say_whose_they_are():
    dimension = SimpleNamespace()
    describe_probabilities(dimension, 2)
    assert dimension.label == "none,segment_1,segment_2"
    assert dimension.size == 3
