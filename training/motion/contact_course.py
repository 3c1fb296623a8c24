"""Contacts that come and go: where, from which side and how hard, tick by tick."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_training.motion.motion_protocol import MotionProtocol

Array = NDArray[np.float64]

_MEAN_FREE_S = 2.0
_SHORTEST_FREE_S = 0.2
_MEAN_HOLD_S = 2.0
_LOG_RISE = (np.log(0.02), np.log(1.5))
_SHARE_OF_WEAK = 0.3
_WEAK_SHARE_OF_FORCE = 0.15
_MOST_TURNED_DEG_S = 20.0
_SWELL = 0.3
_SWELL_HZ = (0.2, 2.0)


class ContactCourse(NamedTuple):
    """Of T ticks: segment (T,), 0 for none; angle (T,), degrees; magnitude (T,), N."""

    segment: NDArray[np.int64]
    angle_deg: Array
    magnitude_n: Array


def drawn_contacts(
    protocol: MotionProtocol, segment_count: int, rng: np.random.Generator
) -> ContactCourse:
    """One contact at a time, with pauses between; most swell, and turn a little, while they last.

    A contact rises within 20 ms to 1.5 s, holds, and falls likewise. A third are weak.
    """
    ticks = protocol.ticks
    segment = np.zeros(ticks, dtype=np.int64)
    angle, magnitude = np.zeros(ticks), np.zeros(ticks)
    time_s = np.arange(ticks) * protocol.tick_s
    start_s = _free_s(rng)
    while start_s < time_s[-1]:
        rise_s, fall_s = np.exp(rng.uniform(*_LOG_RISE, 2))
        hold_s = rng.exponential(_MEAN_HOLD_S)
        end_s = start_s + rise_s + hold_s + fall_s
        rows = np.flatnonzero((time_s > start_s) & (time_s < end_s))
        since = time_s[rows] - start_s
        peak = rng.uniform(0.0, protocol.force_high_n)
        if rng.random() < _SHARE_OF_WEAK:
            peak *= _WEAK_SHARE_OF_FORCE
        envelope = np.minimum(1.0, np.minimum(since / rise_s, (end_s - time_s[rows]) / fall_s))
        swell = rng.uniform(0.0, _SWELL) * (rng.random() < 0.5)
        phase = 2.0 * np.pi * (rng.uniform(*_SWELL_HZ) * since + rng.random())
        segment[rows] = rng.integers(1, segment_count + 1)
        magnitude[rows] = peak * envelope * (1.0 - swell * (0.5 + 0.5 * np.sin(phase)))
        turning = rng.uniform(-_MOST_TURNED_DEG_S, _MOST_TURNED_DEG_S) * (rng.random() < 0.5)
        angle[rows] = (rng.uniform(0.0, 360.0) + turning * since) % 360.0
        start_s = end_s + _free_s(rng)
    return ContactCourse(segment, angle, magnitude)


def _free_s(rng: np.random.Generator) -> float:
    return float(_SHORTEST_FREE_S + rng.exponential(_MEAN_FREE_S))
