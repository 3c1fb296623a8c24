"""Where the cables, the arrows and the parts of the arm lie: plain arrays in, plain arrays out."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cablesense_sim.mechanism import Mechanism

Array = NDArray[np.float64]

ARROW_METRES_PER_NEWTON = 0.002
ARROW_LONGEST_M = 0.45
ARROW_SHORTEST_M = 0.02
ARROWS_APART_M = 0.022
"""True and estimated arrow stand side by side along the segment: neither hides the other."""


@dataclass(frozen=True)
class CablePieces:
    """The straight pieces of all cables, from hole to hole.

    Attributes:
        ends_m: (P, 2, 3) both ends of each piece, base frame.
        cable: (P,) position of the cable that each piece belongs to.
    """

    ends_m: Array
    cable: NDArray[np.int64]


def cable_pieces(
    mechanism: Mechanism, joint_positions_m: Array, segment_rotations: Array
) -> CablePieces:
    """The cables' paths through the guide holes, from the actuators to the anchors.

    Args:
        mechanism: N segments, M cables.
        joint_positions_m: (N, 3) base frame.
        segment_rotations: (N, 3, 3) segment to base frame.
    """
    ends: list[tuple[Array, Array]] = []
    cables: list[int] = []
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
        pairs = list(pairwise(points))
        ends += pairs
        cables += [cable] * len(pairs)
    return CablePieces(np.array(ends), np.array(cables))


def piece_lengths_m(pieces: CablePieces, cable_count: int) -> Array:
    """(M,) length of each cable, the sum over its pieces."""
    lengths = np.linalg.norm(pieces.ends_m[:, 1] - pieces.ends_m[:, 0], axis=-1)
    return np.asarray(np.bincount(pieces.cable, lengths, cable_count), dtype=float)


def unit(vector: Array) -> Array:
    """The unit vector (3,) along a vector that is not zero."""
    return np.asarray(vector / np.linalg.norm(vector))


def arrow_length_m(magnitude_n: float) -> float:
    """Length of a force's arrow: 2 mm per newton, within what can be seen and fits the view."""
    return float(np.clip(magnitude_n * ARROW_METRES_PER_NEWTON, ARROW_SHORTEST_M, ARROW_LONGEST_M))


def arrow_tail_m(contact_m: Array, force_n: Array, clearance_m: float) -> tuple[Array, Array]:
    """Tail and tip (3,) of the arrow that pushes on a contact.

    It points at the arm and ends `clearance_m` before its axis.
    """
    magnitude = float(np.linalg.norm(force_n))
    direction = force_n / magnitude
    tip = contact_m - clearance_m * direction
    return tip - arrow_length_m(magnitude) * direction, tip


def quaternion_z_to(direction: Array) -> Array:
    """Quaternion (..., 4), w x y z, of the shortest turn from +z to `direction` (..., 3).

    The direction need not be of unit length.
    """
    way = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    half = np.stack([1.0 + way[..., 2], -way[..., 1], way[..., 0], np.zeros_like(way[..., 0])], -1)
    opposite = half[..., 0] < 1e-14
    half[opposite] = (0.0, 1.0, 0.0, 0.0)
    return np.asarray(half / np.linalg.norm(half, axis=-1, keepdims=True))


def quaternion_of(rotation: Array) -> Array:
    """Quaternion (4,), w x y z, of a rotation matrix (3, 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(rotation).as_quat(scalar_first=True))
