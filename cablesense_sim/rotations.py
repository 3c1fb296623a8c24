"""Rotations as matrices: from rotation vectors, and to quaternions."""

from __future__ import annotations

import math

import numpy as np

from cablesense_base import Array


def rotation_matrix(rotation_vector_rad: Array) -> Array:
    """The rotations (..., 3, 3) by the lengths of vectors (..., 3), about their directions.

    Rodrigues's formula, R = I + (sin θ / θ) K + ((1 - cos θ) / θ²) K² with K the cross-product
    matrix of the vector; (1 - cos θ) / θ² = ½ (sin(θ/2) / (θ/2))², so that θ may be 0.
    """
    vector = np.asarray(rotation_vector_rad, dtype=float)
    angle_rad = np.linalg.norm(vector, axis=-1)[..., None, None]
    cross = np.zeros((*vector.shape, 3))
    cross[..., 0, 1] = -vector[..., 2]
    cross[..., 0, 2] = vector[..., 1]
    cross[..., 1, 0] = vector[..., 2]
    cross[..., 1, 2] = -vector[..., 0]
    cross[..., 2, 0] = -vector[..., 1]
    cross[..., 2, 1] = vector[..., 0]
    by_sine = np.sinc(angle_rad / np.pi)
    by_cosine = 0.5 * np.sinc(angle_rad / (2.0 * np.pi)) ** 2
    return np.asarray(np.eye(3) + by_sine * cross + by_cosine * (cross @ cross))


def quaternion_xyzw(rotation: Array) -> list[float]:
    """The unit quaternion [x, y, z, w] of a rotation (3, 3); its largest part is positive.

    Shepperd, Quaternion from rotation matrix, Journal of Guidance and Control 1, 1978: of
    4x², 4y², 4z² and 4w² the largest is found from the diagonal, the others from it.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rotation.tolist()
    rows = (
        (1.0 + xx - yy - zz, xy + yx, xz + zx, zy - yz),
        (xy + yx, 1.0 - xx + yy - zz, yz + zy, xz - zx),
        (xz + zx, yz + zy, 1.0 - xx - yy + zz, yx - xy),
        (zy - yz, xz - zx, yx - xy, 1.0 + xx + yy + zz),
    )
    largest = max(range(4), key=lambda part: rows[part][part])
    length = math.hypot(*rows[largest])
    return [number / length for number in rows[largest]]
