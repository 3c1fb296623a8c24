"""The residual of the cables that end on one segment, as common mode and bending parts.

What pulls all cables of a set alike (pretension, creep) is common mode; what bends the arm
(weight, loads, tilt, joint springs) is in the other two. The three are orthonormal, so each has
the noise of one cable, and their squares add up to that of the set where it has three cables.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cablesense_sim.arm import Arm

Array = NDArray[np.float64]

MODES = ("common mode", "bending, y", "bending, z")


def set_modes_n(residual_n: Array, arm: Arm) -> Array:
    """The modes (R, N, 3) of a residual (R, M), N: common, towards +y and towards +z of the holes.

    NaN where a cable of the set has none.
    """
    per_set = arm.cables.per_segment
    by_set = residual_n.reshape(len(residual_n), arm.segment_count, per_set)
    return np.einsum("rnk,nkm->rnm", by_set, _bases(arm))


def _bases(arm: Arm) -> Array:
    angles = arm.cables.angle_deg
    n, k = np.arange(arm.segment_count)[:, None], np.arange(arm.cables.per_segment)
    hole = np.deg2rad(angles.first + n * angles.per_segment + k * angles.per_cable)
    spans = np.stack([np.ones_like(hole), np.sin(hole), np.cos(hole)], axis=-1)
    basis, triangle = np.linalg.qr(spans)
    return basis * np.sign(np.diagonal(triangle, axis1=1, axis2=2))[:, None, :]
