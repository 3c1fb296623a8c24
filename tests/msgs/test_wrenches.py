"""A contact's force, moment, messages and markers; a load is a finite force without torque."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from cablesense_msgs_py.topics import ContractError, Frames
from cablesense_msgs_py.wrenches import (
    ARROW_M_PER_N,
    NO_CONTACT,
    Contact,
    ContactMarkers,
    describe_probabilities,
    put_contact_point,
    put_force_direction,
    read_load,
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


def test_the_arrow_ends_at_the_contact_and_points_along_the_force():
    visualization = pytest.importorskip("visualization_msgs.msg")
    geometry = pytest.importorskip("geometry_msgs.msg")
    time = pytest.importorskip("builtin_interfaces.msg").Time(sec=3)
    markers = ContactMarkers(visualization.MarkerArray(), visualization.Marker, geometry.Point)
    markers.put(Contact(2, 90.0, 50.0, 0.065), Frames(4), time)
    arrow, sphere = markers.array.markers
    tail, tip = arrow.points
    assert (tip.x, tip.y, tip.z) == (0.065, 0.0, 0.0)
    assert tip.y - tail.y == pytest.approx(50.0 * ARROW_M_PER_N)
    assert {m.header.frame_id for m in (arrow, sphere)} == {"segment_2"}
    assert arrow.action == sphere.action == arrow.ADD
    markers.put(NO_CONTACT, Frames(4), time)
    assert arrow.action == sphere.action == arrow.DELETE


def message(force=(0.0, 0.0, 0.0), torque=(0.0, 0.0, 0.0), frame="segment_2"):
    vector = lambda v: SimpleNamespace(x=v[0], y=v[1], z=v[2])  # noqa: E731
    return SimpleNamespace(
        header=SimpleNamespace(frame_id=frame),
        wrench=SimpleNamespace(force=vector(force), torque=vector(torque)),
    )


def test_reads_segment_and_force():
    load = read_load(message((1.0, -2.0, 3.0)), FRAMES)
    assert load.segment == 2
    np.testing.assert_array_equal(load.force_base_n, [1.0, -2.0, 3.0])


@pytest.mark.parametrize(
    ("wrong", "complaint"),
    [
        ({"force": (math.nan, 0.0, 0.0)}, "wrench.force"),
        ({"force": (math.inf, 0.0, 0.0)}, "wrench.force"),
        ({"force": (1e6, 0.0, 0.0)}, "at most 2000 N"),
        ({"torque": (0.0, 0.1, 0.0)}, "must be zero"),
        ({"torque": (0.0, math.nan, 0.0)}, "must be zero"),
        ({"frame": "segment_9"}, "segment_1 … segment_4"),
    ],
)
def test_refuses_what_is_no_load(wrong, complaint):
    with pytest.raises(ContractError, match=complaint):
        read_load(message(**wrong), FRAMES)
