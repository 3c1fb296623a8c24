"""The page's colours: safe for colour-blind eyes, readable on a dark ground.

Tensions use the viridis map without its darkest tenth; the two forces and the segments use the
palette of Okabe and Ito (*Color Universal Design*, 2008).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Rgb = tuple[int, int, int]

TRUE_RGB: Rgb = (230, 159, 0)
ESTIMATE_RGB: Rgb = (86, 180, 233)
SEGMENT_RGB: tuple[Rgb, ...] = ((86, 180, 233), (0, 178, 128), (240, 228, 66), (224, 140, 190))

_TENSION_STOPS = np.array(
    [
        (72, 36, 117),
        (65, 68, 135),
        (53, 95, 141),
        (42, 120, 142),
        (33, 145, 140),
        (34, 168, 132),
        (68, 191, 112),
        (122, 209, 81),
        (189, 223, 38),
        (253, 231, 37),
    ],
    dtype=float,
)


def tension_rgb(tensions_n: ArrayLike, full_scale_n: float) -> NDArray[np.uint8]:
    """Colours (..., 3) of tensions: violet at 0 N (slack), yellow from `full_scale_n` on."""
    share = np.clip(np.nan_to_num(np.asarray(tensions_n, dtype=float)) / full_scale_n, 0.0, 1.0)
    place = share * (len(_TENSION_STOPS) - 1)
    low = np.minimum(place.astype(int), len(_TENSION_STOPS) - 2)
    blend = (place - low)[..., None]
    return np.rint((1 - blend) * _TENSION_STOPS[low] + blend * _TENSION_STOPS[low + 1]).astype(
        np.uint8
    )


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
    return next(
        step * power
        for step in (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.5, 10.0)
        if step * power >= peak_n
    )


def segment_rgb(segment: int) -> Rgb:
    """The colour of a segment's traces and bars; `segment` counts from 1."""
    return SEGMENT_RGB[(segment - 1) % len(SEGMENT_RGB)]


def css(rgb: Rgb | NDArray[np.uint8]) -> str:
    """A colour as `#rrggbb`."""
    return "#{:02x}{:02x}{:02x}".format(*(int(channel) for channel in rgb))


def tension_gradient_css() -> str:
    """The tension map as a CSS gradient, slack on the left."""
    stops = ", ".join(css(stop.astype(np.uint8)) for stop in _TENSION_STOPS)
    return f"linear-gradient(90deg, {stops})"
