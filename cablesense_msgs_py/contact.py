"""A contact as the estimator publishes it: wrench, contact point and force direction."""

from __future__ import annotations

import array
from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, radians, sin
from typing import Any

from cablesense_msgs_py.frames import Frames


@dataclass(frozen=True, slots=True)
class Contact:
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


NO_CONTACT = Contact()


def put_wrench(message: Any, contact: Contact, frames: Frames) -> None:
    """Put the contact's force into a `WrenchStamped`; the stamp is the caller's.

    The frame is the touched segment's, the torque that of the force about this frame's origin.
    Nothing touches: zero, in the base frame.
    """
    force, torque = message.wrench.force, message.wrench.torque
    if contact.segment == 0:
        message.header.frame_id = frames.base
        force.y = force.z = torque.y = torque.z = 0.0
        return
    y, z = contact.direction
    message.header.frame_id = frames.segment(contact.segment)
    force.y = contact.magnitude_n * y
    force.z = contact.magnitude_n * z
    torque.y = -contact.contact_m * force.z
    torque.z = contact.contact_m * force.y


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
