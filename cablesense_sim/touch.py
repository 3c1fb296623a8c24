"""Where an arm can be touched: places along its segments, and the surface there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_sim.arm import Arm, of_each_segment

_ONE_PLACE_M = 2e-3
"""Contacts that are nearer act at one place, as far as any reading tells."""


class TouchedPlaces(NamedTuple):
    """Where the N segments of an arm can be touched.

    Attributes:
        touched_m: (N, 2) nearest and farthest place at which a segment can be touched, from its
            joint centre, along its axis: not where one is touched at the moment.
        radius_m: (N,) of the surface, from the axis; zero where contacts act on the axis.
        friction: bound to axial over normal forces; zero where contacts act on the axis with any
            axial force.
    """

    touched_m: Array
    radius_m: Array
    friction: float


def touched_places(arm: Arm) -> TouchedPlaces:
    """The places of an arm file: by default its whole length, at its cables' distance."""
    count = arm.segment_count
    touch = arm.touch
    length_m = np.array(of_each_segment(arm.segments.length_m, count))
    touched_m = np.stack([np.zeros(count), length_m], axis=1)
    if touch.reach_m is not None:
        touched_m[:] = touch.reach_m
    radius_m = np.array(of_each_segment(arm.cables.routing_radius_m, count))
    if touch.radius_m is not None:
        radius_m[:] = touch.radius_m
    if touch.friction == 0.0:
        radius_m[:] = 0.0
    return TouchedPlaces(touched_m, radius_m, touch.friction)


def is_one_place(touched_m: Array, radius_m: Array) -> NDArray[np.bool_]:
    """(N,) whether links that are touched in ranges (N, 2), of radii (N,), are so at one place.

    Contacts on it are one: they are no farther apart than two millimetres, or than the link is
    thick.
    """
    length_m = touched_m[:, 1] - touched_m[:, 0]
    return np.asarray(length_m <= np.maximum(_ONE_PLACE_M, 2.0 * radius_m))
