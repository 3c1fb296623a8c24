"""A contact as markers for RViz and Foxglove: a sphere where it is, an arrow along the force."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from cablesense_msgs_py.contact import Contact
from cablesense_msgs_py.frames import Frames

ARROW_M_PER_N = 0.004
"""Length of the arrow per newton: 50 N are 0.2 m."""

SPHERE_DIAMETER_M = 0.03
ARROW_DIAMETERS_M = (0.012, 0.024, 0.03)
"""Shaft, head and head length."""

_COLOUR = (0.95, 0.35, 0.1, 1.0)
_ARROW, _SPHERE = 0, 1


class ContactMarkers:
    """Fills a `MarkerArray` made once; the arrow ends at the contact point, as a push does."""

    def __init__(
        self, array: Any, make_marker: Callable[[], Any], make_point: Callable[[], Any]
    ) -> None:
        """`array` is an empty `MarkerArray`; the others are the classes `Marker` and `Point`."""
        self.array = array
        arrow, sphere = make_marker(), make_marker()
        for number, marker in enumerate((arrow, sphere)):
            marker.ns = "contact"
            marker.id = number
            marker.pose.orientation.w = 1.0
            marker.color.r, marker.color.g, marker.color.b, marker.color.a = _COLOUR
        arrow.type, sphere.type = arrow.ARROW, sphere.SPHERE
        arrow.scale.x, arrow.scale.y, arrow.scale.z = ARROW_DIAMETERS_M
        sphere.scale.x = sphere.scale.y = sphere.scale.z = SPHERE_DIAMETER_M
        arrow.points = [make_point(), make_point()]
        array.markers = [arrow, sphere]

    def put(self, contact: Contact, frames: Frames, stamp: Any) -> None:
        """Show the contact, or take the markers away when nothing touches."""
        arrow, sphere = self.array.markers[_ARROW], self.array.markers[_SPHERE]
        for marker in (arrow, sphere):
            marker.header.stamp = stamp
            marker.header.frame_id = (
                frames.segment(contact.segment) if contact.segment else frames.base
            )
            marker.action = marker.ADD if contact.segment else marker.DELETE
        if not contact.segment:
            return
        y, z = contact.direction
        length = ARROW_M_PER_N * contact.magnitude_n
        tail, tip = arrow.points
        tail.x = tip.x = contact.contact_m
        tail.y, tail.z = -length * y, -length * z
        sphere.pose.position.x = contact.contact_m
