"""The colours of forces, tensions and segments.

Colours are safe for colour-blind eyes and readable on a dark ground. Tensions use the viridis map
without its darkest tenth; the two forces and the segments use the palette of Okabe and Ito
(*Color Universal Design*, 2008).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablesense_base import Array

Rgb = tuple[int, int, int]

TRUE_RGB: Rgb = (230, 159, 0)
"""Colour of true forces; these are colours that colour-blind people tell apart (Okabe and Ito)."""
ESTIMATE_RGB: Rgb = (86, 180, 233)
"""Colour of estimated forces."""
_UNREAD_RGB: Rgb = (150, 150, 158)
"""Colour of a cable that nothing reads."""
_SEGMENT_RGB: tuple[Rgb, ...] = ((86, 180, 233), (0, 178, 128), (240, 228, 66), (224, 140, 190))
"""Colours of segments in charts, in turn."""

TENSION_CSS = (
    *("#482475", "#414487", "#355f8d", "#2a788e", "#21918c"),
    *("#22a884", "#44bf70", "#7ad151", "#bddf26", "#fde725"),
)
"""Colours of tensions from slack to full scale, at equal steps."""
_TENSION_STOPS = np.array([list(bytes.fromhex(stop[1:])) for stop in TENSION_CSS], dtype=float)


def tension_rgb(tensions_n: ArrayLike, full_scale_n: float) -> NDArray[np.uint8]:
    """Colours (..., 3) of tensions: violet at 0 N (slack), yellow from `full_scale_n` on."""
    share = np.nan_to_num(np.asarray(tensions_n, dtype=float)) / full_scale_n
    stop_shares = np.linspace(0.0, 1.0, len(_TENSION_STOPS))
    rgb = [np.interp(share, stop_shares, channel) for channel in _TENSION_STOPS.T]
    return np.rint(np.stack(rgb, axis=-1)).astype(np.uint8)


def piece_rgb(
    readings: Array, piece_channel: NDArray[np.int64], full_scale_n: float
) -> NDArray[np.uint8]:
    """Colours (P, 3) of the pieces of cables, by the readings (M,) of their channels.

    `piece_channel` is (P,), -1 for pieces that nothing reads.
    """
    rgb = tension_rgb(readings[np.maximum(piece_channel, 0)], full_scale_n)
    rgb[piece_channel < 0] = _UNREAD_RGB
    return rgb


def linear_rgb(srgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Colours for vertices, which the browser's renderer takes as linear light (IEC 61966-2-1)."""
    share = np.asarray(srgb, dtype=float) / 255.0
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return np.rint(255.0 * linear).astype(np.uint8)


def full_scale_n(peak_n: float, least_n: float) -> float:
    """The round tension that covers a peak, and at least so much: a scale that seldom changes."""
    most_n = max(peak_n, least_n)
    power = 10.0 ** math.floor(math.log10(most_n))
    steps_n = [step * power for step in (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.5, 10.0)]
    return next(step_n for step_n in steps_n if step_n >= most_n)


def segment_rgb(segment: int) -> Rgb:
    """The colour of a segment's traces and bars; `segment` counts from 1."""
    return _SEGMENT_RGB[(segment - 1) % len(_SEGMENT_RGB)]


def css(rgb: Rgb) -> str:
    """A colour as `#rrggbb`."""
    return f"#{bytes(rgb).hex()}"
