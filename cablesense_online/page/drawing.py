"""Geometry and colours of the drawn arm, as arrays.

Colours are safe for colour-blind eyes and readable on a dark ground. Tensions use the viridis map
without its darkest tenth; the two forces and the segments use the palette of Okabe and Ito
(*Color Universal Design*, 2008).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablesense_base import Array
from cablesense_online.page.snapshot import ForceBounds, ShownContact
from cablesense_sim.kinematics import joint_positions_m, segment_rotations
from cablesense_sim.mechanism import Mechanism

PLATE_MARGIN = 1.18
"""Radius of a guide plate over that of its outermost hole."""


@dataclass(frozen=True)
class Arrows:
    """Sizes of the arrows of forces: they follow the arm, and the force that it bears.

    Attributes:
        reach_m: length of the arm.
        strongest_n: the force whose arrow is three quarters as long as that.
    """

    reach_m: float
    strongest_n: float

    def length_m(self, magnitude_n: ArrayLike) -> Array:
        """Length of the arrow of a force, within what can be seen and fits the view."""
        share = 0.75 * np.asarray(magnitude_n) / self.strongest_n
        return self.reach_m * np.clip(share, 0.1, 0.85)

    @property
    def apart_m(self) -> float:
        """Distance of true and estimated arrow along the segment: neither hides the other."""
        return 0.015 * self.reach_m


def routing_radius_m(mechanism: Mechanism) -> float:
    """The largest distance of a guide hole from the axis: all drawn parts follow it."""
    return float(np.hypot(mechanism.hole_y_m, mechanism.hole_z_m).max())


def plate_positions_m(mechanism: Mechanism, segment: int) -> list[float]:
    """Places of the guide plates of a segment (1 … N; 0 is the base) along its own x axis."""
    if segment == 0:
        return [0.0]
    length = float(mechanism.segment_length_m[segment - 1])
    return [mechanism.plate_offset_m, length - mechanism.plate_offset_m]


def cable_pieces(mechanism: Mechanism, joint_angles_rad: Array) -> tuple[Array, NDArray[np.int64]]:
    """The straight pieces of all cables, from actuator to anchor through the guide holes.

    Returns:
        Both ends (P, 2, 3) of each piece, base frame, and the position (P,) of its cable.
    """
    joints_m = joint_positions_m(mechanism, joint_angles_rad)
    rotations = segment_rotations(mechanism, joint_angles_rad)
    ends: list[tuple[Array, Array]] = []
    for cable, last_segment in enumerate(mechanism.cable_segment):
        y, z = mechanism.hole_y_m[cable], mechanism.hole_z_m[cable]
        points = [np.array([-mechanism.run_m, y, z]), np.array([0.0, y, z])]
        for n in range(1, last_segment + 1):
            plates_m = plate_positions_m(mechanism, n)
            for x in plates_m[:1] if n == last_segment else plates_m:
                points.append(joints_m[n - 1] + rotations[n - 1] @ np.array([x, y, z]))
        ends += pairwise(points)
    pieces_each = 2 * mechanism.cable_segment
    return np.array(ends), np.repeat(np.arange(mechanism.cable_count), pieces_each)


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


INTERVAL_LINES = 66
"""Half of them for each arc."""


def interval_m(
    contact_m: Array,
    normal: Array,
    estimate: ShownContact,
    bounds: ForceBounds,
    clearance_m: float,
    arrows: Arrows,
) -> Array:
    """Lines (L, 2, 3) around the places where the arrow of a force in its interval may begin.

    Args:
        contact_m: (3,) as in `arrow_m`.
        normal: (3,) of the plane that the force turns in: the axis of the segment.
        estimate: the force whose arrow the lines begin at; its part along the axis is left out.
        bounds: its intervals.
        clearance_m: as in `arrow_m`.
        arrows: their sizes.
    """
    ahead = unit(estimate.force_base_n - (estimate.force_base_n @ normal) * normal)
    aside = np.cross(ahead, normal)  # contact angles grow from +z to +y, against the axis' screw
    first_deg, last_deg = bounds.angles_deg or (0.0, 360.0)
    width_deg = (last_deg - first_deg) % 360.0 if bounds.angles_deg else 360.0
    turn = np.deg2rad(
        first_deg - estimate.angle_deg + np.linspace(0.0, width_deg, INTERVAL_LINES // 2)
    )
    rays = np.outer(np.cos(turn), ahead) + np.outer(np.sin(turn), aside)
    near, far = (
        contact_m - (clearance_m + arrows.length_m(end_n)) * rays
        for end_n in (bounds.low_n, bounds.high_n)
    )
    outline = np.concatenate([near, far[::-1], near[:1]])
    return np.stack([outline[:-1], outline[1:]], axis=1)


def place_m(joint_m: Array, axis: Array, ray_origin: Array, ray_direction: Array) -> float:
    """Distance from a joint centre of the point on a segment's axis that is nearest to a ray.

    All are (3,) in one frame; the axis is a unit vector. The distance is NaN along the axis.
    """
    ahead = unit(ray_direction)
    aside = axis - (axis @ ahead) * ahead
    with np.errstate(invalid="ignore", divide="ignore"):
        return float((ray_origin - joint_m) @ aside / (aside @ axis))


VIEW_ANGLE_RAD = 0.75
"""Height of the view."""
_SIDE_VIEW = np.array([0.36, -1.66, 0.74])
_TALL = 0.6
"""The view of a phone, upright: its lower part is under the panel."""


def view(reach_m: float, aspect: float) -> tuple[Array, Array]:
    """Camera position and the point that it looks at, (3,) each, to see an arm of a reach.

    `aspect` is the view's width over its height.
    """
    look_at = reach_m * np.array([0.56, 0.0, -0.04])
    from_there = reach_m * _SIDE_VIEW * max(1.0, 1.05 / max(aspect, 0.2))
    if aspect < _TALL:
        half_height_m = float(np.linalg.norm(from_there)) * math.tan(0.5 * VIEW_ANGLE_RAD)
        look_at = look_at - np.array([0.0, 0.0, 0.55 * half_height_m])
    return look_at + from_there, look_at


Rgb = tuple[int, int, int]

TRUE_RGB: Rgb = (230, 159, 0)
ESTIMATE_RGB: Rgb = (86, 180, 233)
_SEGMENT_RGB: tuple[Rgb, ...] = ((86, 180, 233), (0, 178, 128), (240, 228, 66), (224, 140, 190))

TENSION_CSS = (
    *("#482475", "#414487", "#355f8d", "#2a788e", "#21918c"),
    *("#22a884", "#44bf70", "#7ad151", "#bddf26", "#fde725"),
)
"""Colours of tensions from slack to full scale, at equal steps."""
_TENSION_STOPS = np.array([list(bytes.fromhex(stop[1:])) for stop in TENSION_CSS], dtype=float)


def tension_rgb(tensions_n: ArrayLike, full_scale_n: float) -> NDArray[np.uint8]:
    """Colours (..., 3) of tensions: violet at 0 N (slack), yellow from `full_scale_n` on."""
    share = np.nan_to_num(np.asarray(tensions_n, dtype=float)) / full_scale_n
    at = np.linspace(0.0, 1.0, len(_TENSION_STOPS))
    rgb = [np.interp(share, at, channel) for channel in _TENSION_STOPS.T]
    return np.rint(np.stack(rgb, axis=-1)).astype(np.uint8)


def linear_rgb(srgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Colours for vertices, which the browser's renderer takes as linear light (IEC 61966-2-1)."""
    share = np.asarray(srgb, dtype=float) / 255.0
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return np.rint(255.0 * linear).astype(np.uint8)


def full_scale_n(peak_n: float) -> float:
    """The round tension, at least 100 N, that covers a peak: a scale that seldom changes."""
    power = 10.0 ** max(2, math.floor(math.log10(max(peak_n, 1.0))))
    steps_n = [step * power for step in (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.5, 10.0)]
    return next(step_n for step_n in steps_n if step_n >= peak_n)


def segment_rgb(segment: int) -> Rgb:
    """The colour of a segment's traces and bars; `segment` counts from 1."""
    return _SEGMENT_RGB[(segment - 1) % len(_SEGMENT_RGB)]


def css(rgb: Rgb) -> str:
    """A colour as `#rrggbb`."""
    return f"#{bytes(rgb).hex()}"
