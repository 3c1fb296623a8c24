"""Forces as drawn: arrows, how long they are, and what a drag pulls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cablesense_base import Array
from cablesense_msgs_py.messages import Contact


@dataclass(frozen=True)
class ArrowScale:
    """How long arrows are: that of `strongest_n` is 3/4 of `size_m`, the size of the machine."""

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


def arrow_m(contact_m: Array, force_n: Array, clearance_m: float, scale: ArrowScale) -> Array:
    """Tail and tip (2, 3) of the arrow that pushes on a contact.

    It points at the arm and ends `clearance_m` before its axis.
    """
    direction = unit(force_n)
    tip = contact_m - clearance_m * direction
    return np.stack([tip - scale.length_m(np.linalg.norm(force_n)) * direction, tip])


CLEARANCE = 1.1
"""Distance of an arrow's tip from the axis, over the radius of the link."""


def place_m(joint_m: Array, axis: Array, ray_origin: Array, ray_direction: Array) -> float:
    """Distance from a joint centre of the point on a link's axis that is nearest to a ray.

    All are (3,) in one frame; the axis is a unit vector. The distance is NaN along the axis.
    """
    ahead = unit(ray_direction)
    aside = axis - (axis @ ahead) * ahead
    with np.errstate(invalid="ignore", divide="ignore"):
        return float((ray_origin - joint_m) @ aside / (aside @ axis))


def pulled_contact(
    segment: int, joint_m: Array, axis: Array, at_command: Array, ends_m: Array, scale: ArrowScale
) -> Contact:
    """The contact that pulls a segment, 1 … N, from one point to another.

    Args:
        segment: that is pulled.
        joint_m: (3,) its joint centre, base frame, as the following ones.
        axis: (3,) of the segment, a unit vector.
        at_command: (3, 3) its rotation at the commanded pose, in whose axes contacts are.
        ends_m: (2, 3) where the segment is held, and where to.
        scale: says how many newtons a length is.
    """
    (held_m, towards_m) = ends_m
    force_n = scale.newtons_per_m * (towards_m - held_m)
    place_m = float((held_m - joint_m) @ axis)
    return Contact.of_force(segment, (force_n @ at_command).tolist(), place_m)
