"""Guide holes that are not where they were drawn."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cablesense_sim.effects.effect import Array

if TYPE_CHECKING:
    from cablesense_sim.mechanism import Mechanism

Numbers = NDArray[np.floating[Any]]


def with_cables_moved(mechanism: Mechanism, outward_m: Numbers, turned_rad: Numbers) -> Mechanism:
    """Every hole of a cable further out and turned from +z towards +y, each (M,)."""
    y, z = _moved_m(mechanism.hole_y_m, mechanism.hole_z_m, outward_m, turned_rad)
    moved = replace(mechanism, hole_y_m=y, hole_z_m=z)
    if mechanism.segment_hole_y_m is None or mechanism.segment_hole_z_m is None:
        return moved
    y, z = _moved_m(
        mechanism.segment_hole_y_m,
        mechanism.segment_hole_z_m,
        outward_m[:, None],
        turned_rad[:, None],
    )
    return replace(moved, segment_hole_y_m=y, segment_hole_z_m=z)


def with_plates_moved(mechanism: Mechanism, outward_m: Numbers, turned_rad: Numbers) -> Mechanism:
    """Every hole in the plates that a segment carries further out and turned, each (N,)."""
    y, z = mechanism.segment_hole_y_m, mechanism.segment_hole_z_m
    if y is None or z is None:
        y, z = mechanism.hole_y_m[:, None], mechanism.hole_z_m[:, None]
    y, z = _moved_m(y, z, outward_m, turned_rad)
    return replace(mechanism, segment_hole_y_m=y, segment_hole_z_m=z)


def _moved_m(y: Array, z: Array, outward_m: Numbers, turned_rad: Numbers) -> tuple[Array, Array]:
    radius = np.hypot(y, z) + outward_m
    angle = np.arctan2(y, z) + turned_rad
    return np.asarray(radius * np.sin(angle), float), np.asarray(radius * np.cos(angle), float)
