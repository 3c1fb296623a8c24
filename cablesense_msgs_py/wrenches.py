"""A contact as the estimator publishes it, with its markers, and a known load as received."""

from __future__ import annotations

import array
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import cos, radians, sin
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_msgs_py.topics import ContractError, Frames


class Contact(NamedTuple):
    """Where and how the environment pushes the arm, or that it does not.

    Attributes:
        segment: the touched segment, counted from 1; 0 when nothing touches.
        angle_deg: direction of the force in the plane normal to the segment at the commanded joint
            angles, from +z towards +y of that segment's frame.
        magnitude_n: of the force, N.
        contact_m: distance of the contact point from the segment's joint centre, along its axis.
    """

    segment: int = 0
    angle_deg: float = 0.0
    magnitude_n: float = 0.0
    contact_m: float = 0.0

    @property
    def direction(self) -> tuple[float, float]:
        """(y, z) of the force's unit vector in the segment's frame; x is zero."""
        return sin(radians(self.angle_deg)), cos(radians(self.angle_deg))

    @property
    def force_n(self) -> tuple[float, float, float]:
        """The force, in the segment's frame."""
        y, z = self.direction
        return 0.0, self.magnitude_n * y, self.magnitude_n * z

    @property
    def wrench(self) -> tuple[float, float, float, float, float, float]:
        """The force, N, and its moment about the origin of the segment's frame, N·m."""
        x, y, z = self.force_n
        return x, y, z, 0.0, -self.contact_m * z, self.contact_m * y


NO_CONTACT = Contact()


def put_contact_point(message: Any, contact: Contact, frames: Frames) -> None:
    """Put the point of a contact into a `PointStamped` in the touched segment's frame."""
    message.header.frame_id = frames.segment(contact.segment)
    message.point.x = contact.contact_m


def put_force_direction(message: Any, contact: Contact, frames: Frames) -> None:
    """Put a force's unit vector into a `Vector3Stamped` in the touched segment's frame."""
    message.header.frame_id = frames.segment(contact.segment)
    message.vector.y, message.vector.z = contact.direction


def put_probabilities(message: Any, probabilities: Sequence[float]) -> None:
    """Put P(no contact), P(segment 1), … into a `Float64MultiArray` whose layout is set."""
    message.data = array.array("d", probabilities)


def describe_probabilities(dimension: Any, segment_count: int) -> None:
    """Fill the `MultiArrayDimension` that states what the probabilities belong to."""
    dimension.label = "none," + ",".join(f"segment_{n + 1}" for n in range(segment_count))
    dimension.size = dimension.stride = segment_count + 1


MAX_LOAD_N = 2_000.0
"""A larger force is a wrong unit or a slip, not a push."""


@dataclass(frozen=True)
class Load:
    """A force (3,) in N, base axes, at the contact point of segment `segment` (counted from 1)."""

    segment: int
    force_base_n: NDArray[np.float64]


def read_load(message: Any, frames: Frames) -> Load:
    """The load that a `WrenchStamped` describes.

    Raises:
        ContractError: an unknown frame, a force that is not finite or too large, or a torque.
    """
    segment = frames.segment_number(message.header.frame_id)
    force, torque = message.wrench.force, message.wrench.torque
    components = (force.x, force.y, force.z)
    if not math.hypot(*components) <= MAX_LOAD_N:
        raise ContractError(
            f"wrench.force is {_shown(components)} N; it must be finite, at most {MAX_LOAD_N:g} N"
        )
    if any(component != 0.0 for component in (torque.x, torque.y, torque.z)):
        raise ContractError(
            f"wrench.torque is {_shown((torque.x, torque.y, torque.z))} N·m; it must be zero: "
            "a load is a force at the contact point of the segment"
        )
    return Load(segment, np.array(components, dtype=np.float64))


def _shown(vector: tuple[float, ...]) -> str:
    return "(" + ", ".join(f"{component:g}" for component in vector) + ")"


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
