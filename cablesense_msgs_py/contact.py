"""A contact as the estimator publishes it: wrench, contact point and force direction."""

from __future__ import annotations

import array
from collections.abc import Sequence
from math import cos, radians, sin
from typing import Any, NamedTuple

from cablesense_msgs_py.frames import Frames


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
    """Fill the `MultiArrayDimension` that says what the probabilities belong to."""
    dimension.label = "none," + ",".join(f"segment_{n + 1}" for n in range(segment_count))
    dimension.size = dimension.stride = segment_count + 1
