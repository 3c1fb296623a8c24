"""Forces that change faster than anything at rest can: a tap, a bumped table.

While the arm swings, its inertia is in the readings, and statics calls it a force. A statement is
confirmed once the force of the samples within a moment before lies in its interval.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from cablesense_base import Array
from cablesense_contact.estimate import NORMAL_95, Estimate

_MOMENT_NS = 150_000_000
"""An arm on cables swings with some 5 to 20 Hz; half a period of the slowest."""
_LEAST_N = 0.5
"""Changes below this are no transient."""


@dataclass(frozen=True)
class _Seen:
    stamp_ns: int
    torque_n_m: Array
    half_n_m: float


class Transients:
    """The estimates of the last moment."""

    def __init__(self) -> None:
        self._seen: deque[_Seen] = deque()

    def forget(self) -> None:
        """Nothing before the next sample counts."""
        self._seen.clear()

    def changing(self, estimate: Estimate, lever_m: float, stamp_ns: int) -> bool:
        """Whether the moment of the contact has changed by more than its interval just now.

        `lever_m` is from the arm's first joint to the contact: the moment of the force about it
        is continuous where the contact passes from one segment to the next.
        """
        angle = np.deg2rad(estimate.angle_deg)
        size_n = estimate.magnitude_n if estimate.segment else 0.0
        torque = size_n * lever_m * np.array([np.sin(angle), np.cos(angle)])
        half_n = max(NORMAL_95 * estimate.magnitude_std_n, _LEAST_N)
        now = _Seen(stamp_ns, torque, half_n * max(lever_m, 1e-3))
        while self._seen and not 0 <= stamp_ns - self._seen[0].stamp_ns <= _MOMENT_NS:
            self._seen.popleft()
        changed = any(
            float(np.hypot(*(then.torque_n_m - torque))) > then.half_n_m + now.half_n_m
            for then in self._seen
        )
        self._seen.append(now)
        return changed
