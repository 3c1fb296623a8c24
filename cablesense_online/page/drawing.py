"""Geometry and colours of the drawn arm: arrays in, arrays or meshes out.

Colours are safe for colour-blind eyes and readable on a dark ground. Tensions use the viridis map
without its darkest tenth; the two forces and the segments use the palette of Okabe and Ito
(*Color Universal Design*, 2008).
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import cast

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from cablesense_base import Array
from cablesense_sim.mechanism import Mechanism

ARROW_METRES_PER_NEWTON = 0.002
ARROW_LONGEST_M = 0.45
ARROW_SHORTEST_M = 0.02
ARROWS_APART_M = 0.022
"""True and estimated arrow stand side by side along the segment: neither hides the other."""


def cable_pieces(
    mechanism: Mechanism, joint_positions_m: Array, segment_rotations: Array
) -> tuple[Array, NDArray[np.int64]]:
    """The straight pieces of all cables, from actuator to anchor through the guide holes.

    Joint positions (N, 3) in the base frame; rotations (N, 3, 3) from segment to base frame.

    Returns:
        Both ends (P, 2, 3) of each piece, base frame, and the position (P,) of its cable.
    """
    ends: list[tuple[Array, Array]] = []
    for cable, last_segment in enumerate(mechanism.cable_segment):
        y, z = mechanism.hole_y_m[cable], mechanism.hole_z_m[cable]
        points = [np.array([-mechanism.run_m, y, z]), np.array([0.0, y, z])]
        for n in range(last_segment):
            holes_x = [mechanism.plate_offset_m]
            if n + 1 < last_segment:
                holes_x.append(mechanism.segment_length_m[n] - mechanism.plate_offset_m)
            points += [
                joint_positions_m[n] + segment_rotations[n] @ np.array([x, y, z]) for x in holes_x
            ]
        ends += pairwise(points)
    pieces_each = 2 * mechanism.cable_segment
    return np.array(ends), np.repeat(np.arange(mechanism.cable_count), pieces_each)


def unit(vector: Array) -> Array:
    """The unit vector along a vector that is not zero."""
    return np.asarray(vector / np.linalg.norm(vector))


def arrow_tail_m(contact_m: Array, force_n: Array, clearance_m: float) -> tuple[Array, Array]:
    """Tail and tip (3,) of the arrow that pushes on a contact.

    It points at the arm and ends `clearance_m` before its axis. Its length is 2 mm per newton,
    within what can be seen and fits the view.
    """
    magnitude_n = float(np.linalg.norm(force_n))
    direction = force_n / magnitude_n
    tip = contact_m - clearance_m * direction
    return tip - _arrow_length_m(magnitude_n) * direction, tip


def _arrow_length_m(magnitude_n: float) -> float:
    length_m = magnitude_n * ARROW_METRES_PER_NEWTON
    return min(max(length_m, ARROW_SHORTEST_M), ARROW_LONGEST_M)


_RAYS, _THICKEST_RAD = 33, math.radians(10.0)
_RING = 4 * np.arange(_RAYS - 1)[:, None]
_SIDES = [_RING + np.array([j, (j + 1) % 4, 4 + (j + 1) % 4, 4 + j]) for j in range(4)]
_ENDS = np.array([[3, 2, 1, 0], np.arange(4 * _RAYS - 4, 4 * _RAYS)])
_QUADS = np.vstack([*_SIDES, _ENDS])
INTERVAL_FACES = np.vstack([_QUADS[:, [0, 1, 2]], _QUADS[:, [0, 2, 3]]])
"""Triangles of the wedge that `interval_wedge_m` gives the corners of."""


def interval_wedge_m(
    contact_m: Array,
    force_n: Array,
    normal: Array,
    clearance_m: float,
    ends_n: tuple[float, float],
    turns_rad: tuple[float, float],
) -> Array:
    """Corners (132, 3) of the wedge in which the tail of a force's arrow may begin.

    The forces are of one plane; the wedge is as thick as it is wide, up to 20 degrees, as it would
    not be seen from beside.

    Args:
        contact_m: (3,) as in `arrow_tail_m`, with `force_n` and `clearance_m`.
        force_n: (3,).
        normal: (3,) of the plane that the force turns in; contact angles grow against its screw.
        clearance_m: from the axis to the tip.
        ends_n: least and greatest force.
        turns_rad: from the force's direction, the first and the last one.
    """
    ahead = unit(force_n)
    aside = unit(np.cross(ahead, normal))
    across = np.cross(aside, ahead)
    first, last = turns_rad
    turns = np.linspace(first, last, _RAYS)[:, None, None]
    tilt = min(0.5 * (last - first), _THICKEST_RAD) * np.array([[-1.0], [-1.0], [1.0], [1.0]])
    rays = np.cos(tilt) * (np.cos(turns) * ahead + np.sin(turns) * aside) + np.sin(tilt) * across
    low_m, high_m = (clearance_m + _arrow_length_m(end_n) for end_n in ends_n)
    lengths_m = np.array([[low_m], [high_m], [high_m], [low_m]])
    return np.asarray(contact_m - lengths_m * rays).reshape(-1, 3)


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
        half_height = float(np.linalg.norm(from_there)) * math.tan(0.5 * VIEW_ANGLE_RAD)
        look_at = look_at - np.array([0.0, 0.0, 0.55 * half_height])
    return look_at + from_there, look_at


def quaternion_z_to(direction: Array) -> Array:
    """Quaternion (4,), w x y z, of the shortest turn from +z to a direction (3,)."""
    x, y, z = unit(direction)
    opposite = 1.0 + z < 1e-14
    return unit(np.array([0.0, 1.0, 0.0, 0.0] if opposite else [1.0 + z, -y, x, 0.0]))


Rgb = tuple[int, int, int]

TRUE_RGB: Rgb = (230, 159, 0)
ESTIMATE_RGB: Rgb = (86, 180, 233)
SEGMENT_RGB: tuple[Rgb, ...] = ((86, 180, 233), (0, 178, 128), (240, 228, 66), (224, 140, 190))

_TENSION_CSS = (
    *("#482475", "#414487", "#355f8d", "#2a788e", "#21918c"),
    *("#22a884", "#44bf70", "#7ad151", "#bddf26", "#fde725"),
)
TENSION_GRADIENT_CSS = f"linear-gradient(90deg, {', '.join(_TENSION_CSS)})"
"""The tension map, slack on the left."""
_TENSION_STOPS = np.array([list(bytes.fromhex(stop[1:])) for stop in _TENSION_CSS], dtype=float)


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
    if not peak_n > 100.0:
        return 100.0
    power = 10.0 ** math.floor(math.log10(peak_n))
    steps = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.5, 10.0)
    return next(step * power for step in steps if step * power >= peak_n)


def segment_rgb(segment: int) -> Rgb:
    """The colour of a segment's traces and bars; `segment` counts from 1."""
    return SEGMENT_RGB[(segment - 1) % len(SEGMENT_RGB)]


def css(rgb: Rgb) -> str:
    """A colour as `#rrggbb`."""
    return f"#{bytes(rgb).hex()}"


_X_FROM_Z = trimesh.transformations.rotation_matrix(np.pi / 2, [0.0, 1.0, 0.0])
PLATE_THICKNESS_M = 0.004
PLATE_MARGIN = 1.18
BODY_SHARE = 0.34
HOLE_RADIUS_M = 0.0032


def routing_radius_m(mechanism: Mechanism) -> float:
    """The largest distance of a guide hole from the axis: all drawn parts follow it."""
    return float(np.hypot(mechanism.hole_y_m, mechanism.hole_z_m).max())


def _disc(x_m: float, radius_m: float, thickness_m: float) -> trimesh.Trimesh:
    disc = trimesh.creation.cylinder(radius_m, thickness_m, sections=48)
    disc.apply_transform(_X_FROM_Z)
    disc.apply_translation([x_m, 0.0, 0.0])
    return disc


def _joined(parts: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    """One mesh of many, so that the browser has one thing to draw."""
    return cast(trimesh.Trimesh, trimesh.util.concatenate(parts))


def plate_positions_m(mechanism: Mechanism, segment: int) -> list[float]:
    """Places of the guide plates of a segment (1 … N; 0 is the base) along its own x axis."""
    if segment == 0:
        return [0.0]
    length = float(mechanism.segment_length_m[segment - 1])
    return [mechanism.plate_offset_m, length - mechanism.plate_offset_m]


def plates(mechanism: Mechanism, segment: int) -> trimesh.Trimesh:
    """The guide plates of a segment, or the base plate for 0."""
    radius = PLATE_MARGIN * routing_radius_m(mechanism)
    positions = plate_positions_m(mechanism, segment)
    return _joined([_disc(x, radius, PLATE_THICKNESS_M) for x in positions])


def grommets(mechanism: Mechanism, segment: int) -> trimesh.Trimesh:
    """The rims of the holes that cables pass, in the plates of a segment."""
    rims = []
    for cable, last in enumerate(mechanism.cable_segment):
        for place, x in enumerate(plate_positions_m(mechanism, segment)):
            passes = last > segment if segment == 0 or place == 1 else last >= segment
            if passes:
                rim = _disc(x, HOLE_RADIUS_M, PLATE_THICKNESS_M * 1.5)
                rim.apply_translation([0, mechanism.hole_y_m[cable], mechanism.hole_z_m[cable]])
                rims.append(rim)
    return _joined(rims) if rims else trimesh.Trimesh()


def body(mechanism: Mechanism, segment: int) -> trimesh.Trimesh:
    """A segment's spine between its plates, with the necks that lead to its joints."""
    radius = BODY_SHARE * routing_radius_m(mechanism)
    length = float(mechanism.segment_length_m[segment - 1])
    offset = mechanism.plate_offset_m
    last = segment == mechanism.segment_count
    spine = _disc(length / 2, radius, length - 2 * offset)
    neck_end = length if last else length - 0.2 * offset
    neck = _disc((0.2 * offset + neck_end) / 2, 0.45 * radius, neck_end - 0.2 * offset)
    return _joined([spine, neck])


def unit_arrow() -> dict[str, trimesh.Trimesh]:
    """Its `shaft` and its `head`, each of radius 1 from the origin to +z = 1, to be scaled."""
    shaft = trimesh.creation.cylinder(1.0, 1.0, sections=12)
    shaft.apply_translation([0.0, 0.0, 0.5])
    return {"shaft": shaft, "head": trimesh.creation.cone(1.0, 1.0, sections=32)}
