"""What is drawn beside the machine itself, alike on the page and in pictures.

The interval of a place is a band around the link, that of a force the outline of where the
force's arrow may begin.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_online.page.arrows import ArrowScale, unit
from cablesense_online.page.snapshot import ForceBounds, PlaceInterval

CABLE_WIDTH = 0.008
"""Of a drawn cable, as a share of the machine's size, as the following ones."""
FORCE_OUTLINE_WIDTH = 0.006
"""Of the line around the interval of a force."""
_THINNEST_BAND = 0.01
"""Of the band of a place, along the link."""
BAND_SHARE = 1.3
"""Radius of the band of a place, over that of the link."""
BAND_OPACITY = 0.6
"""Of this band: the link stays visible."""
FORCE_OUTLINE_LINES = 66
"""Half of them for each arc."""


class PlaceBand(NamedTuple):
    """The band of an interval of places: its middle on the link's axis, and its length."""

    middle_m: float
    length_m: float


def place_band(part: PlaceInterval, size_m: float) -> PlaceBand:
    """The band of the part of an interval that is on one link, of a machine of a size."""
    length_m = max(part.high_m - part.low_m, _THINNEST_BAND * size_m)
    return PlaceBand(0.5 * (part.low_m + part.high_m), length_m)


def interval_outline_m(
    contact_m: Array,
    normal: Array,
    force_n: Array,
    angle_deg: float,
    bounds: ForceBounds,
    clearance_m: float,
    scale: ArrowScale,
) -> Array:
    """Lines (L, 2, 3), m, around the places where the arrow of a force within `bounds` may begin.

    It turns in the plane with the `normal` (3,), the axis of the segment. The lines begin at the
    arrow of the estimated force (3,), at its contact angle; its part along the axis is left out.
    The others as in `arrow_m`.
    """
    ahead = unit(force_n - (force_n @ normal) * normal)
    aside = np.cross(ahead, normal)  # contact angles grow from +z to +y, against the axis' screw
    first_deg = 0.0
    width_deg = 360.0
    if bounds.angles_deg:
        first_deg = bounds.angles_deg[0]
        width_deg = (bounds.angles_deg[1] - first_deg) % 360.0
    turned_deg = first_deg - angle_deg + np.linspace(0.0, width_deg, FORCE_OUTLINE_LINES // 2)
    turn = np.deg2rad(turned_deg)
    rays = np.outer(np.cos(turn), ahead) + np.outer(np.sin(turn), aside)
    near, far = (
        contact_m - (clearance_m + scale.length_m(end_n)) * rays
        for end_n in (bounds.low_n, bounds.high_n)
    )
    outline = np.concatenate([near, far[::-1], near[:1]])
    return np.stack([outline[:-1], outline[1:]], axis=1)
