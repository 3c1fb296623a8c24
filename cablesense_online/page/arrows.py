"""Forces as drawn: arrows with their sizes, the outline of an interval, and what a drag pulls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cablesense_base import Array
from cablesense_msgs_py.messages import Contact
from cablesense_online.page.snapshot import ForceBounds


@dataclass(frozen=True)
class Arrows:
    """Sizes of arrows: that of `strongest_n` is 3/4 of `size_m`, the size of the machine."""

    size_m: float
    strongest_n: float

    def length_m(self, magnitude_n: ArrayLike) -> Array:
        """Within what can be seen and fits the view."""
        share = 0.75 * np.asarray(magnitude_n) / self.strongest_n
        return self.size_m * np.clip(share, 0.1, 0.85)

    @property
    def newtons_per_m(self) -> float:
        """The force of a metre, as far as arrows are neither the shortest nor the longest."""
        return self.strongest_n / (0.75 * self.size_m)

    @property
    def apart_m(self) -> float:
        """Distance of true and estimated arrow along the link: neither hides the other."""
        return 0.015 * self.size_m


def unit(vector: Array) -> Array:
    """The unit vector along a vector that is not zero."""
    return np.asarray(vector / np.linalg.norm(vector))


def arrow_m(contact_m: Array, force_n: Array, clearance_m: float, arrows: Arrows) -> Array:
    """Tail and tip (2, 3) of the arrow that pushes on a contact.

    It points at the arm and ends `clearance_m` before its axis.
    """
    direction = unit(force_n)
    tip = contact_m - clearance_m * direction
    return np.stack([tip - arrows.length_m(np.linalg.norm(force_n)) * direction, tip])


CLEARANCE = 1.1
"""Distance of an arrow's tip from the axis, over the radius of the link."""
INTERVAL_LINES = 66
"""Half of them for each arc."""


def interval_m(
    contact_m: Array,
    normal: Array,
    force_n: Array,
    angle_deg: float,
    bounds: ForceBounds,
    clearance_m: float,
    arrows: Arrows,
) -> Array:
    """Lines (L, 2, 3) around the places where the arrow of a force within `bounds` may begin.

    It turns in the plane with the `normal` (3,), the axis of the segment. The lines begin at the
    arrow of the estimated force (3,), at its contact angle; its part along the axis is left out.
    The others as in `arrow_m`.
    """
    ahead = unit(force_n - (force_n @ normal) * normal)
    aside = np.cross(ahead, normal)  # contact angles grow from +z to +y, against the axis' screw
    first_deg, last_deg = bounds.angles_deg or (0.0, 360.0)
    width_deg = (last_deg - first_deg) % 360.0 if bounds.angles_deg else 360.0
    turn = np.deg2rad(first_deg - angle_deg + np.linspace(0.0, width_deg, INTERVAL_LINES // 2))
    rays = np.outer(np.cos(turn), ahead) + np.outer(np.sin(turn), aside)
    near, far = (
        contact_m - (clearance_m + arrows.length_m(end_n)) * rays
        for end_n in (bounds.low_n, bounds.high_n)
    )
    outline = np.concatenate([near, far[::-1], near[:1]])
    return np.stack([outline[:-1], outline[1:]], axis=1)


def place_m(joint_m: Array, axis: Array, ray_origin: Array, ray_direction: Array) -> float:
    """Distance from a joint centre of the point on a link's axis that is nearest to a ray.

    All are (3,) in one frame; the axis is a unit vector. The distance is NaN along the axis.
    """
    ahead = unit(ray_direction)
    aside = axis - (axis @ ahead) * ahead
    with np.errstate(invalid="ignore", divide="ignore"):
        return float((ray_origin - joint_m) @ aside / (aside @ axis))


def pulled_contact(
    segment: int, joint_m: Array, axis: Array, at_command: Array, ends_m: Array, arrows: Arrows
) -> Contact:
    """The contact that pulls a segment, 1 … N, from one point to another.

    Args:
        segment: that is pulled.
        joint_m: (3,) its joint centre, base frame, as the following ones.
        axis: (3,) of the segment, a unit vector.
        at_command: (3, 3) its rotation at the commanded pose, in whose axes contacts are.
        ends_m: (2, 3) where the segment is held, and where to.
        arrows: say how many newtons a length is.
    """
    (held_m, towards_m) = ends_m
    force_n = arrows.newtons_per_m * (towards_m - held_m)
    place_m = float((held_m - joint_m) @ axis)
    return Contact.of_force(segment, (force_n @ at_command).tolist(), place_m)
