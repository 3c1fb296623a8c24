"""Markers show a contact and go when it goes."""

import pytest

from cablesense_msgs_py.topics import Frames
from cablesense_msgs_py.wrenches import ARROW_M_PER_N, NO_CONTACT, Contact, ContactMarkers

pytestmark = pytest.mark.filterwarnings(
    "ignore:module .sre_:DeprecationWarning"
)  # lark, of rosidl


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
