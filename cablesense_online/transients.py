"""Forces that change faster than anything at rest can: a tap, a bumped table.

While the arm swings, its inertia is in the readings, and statics calls it a force. A statement is
confirmed once the force of the samples within a moment before lies in its interval.
"""

from __future__ import annotations

import math

import numpy as np

from cablesense_contact.estimate import NORMAL_95, Estimate

_MOMENT_NS = 150_000_000
"""An arm on cables swings with some 5 to 20 Hz; half a period of the slowest."""
_LEAST_N = 0.5
"""Changes below this are no transient."""


class Transients:
    """The estimates of the last moment."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Nothing before the next sample counts."""
        self._stamps_ns = np.empty(0, dtype=np.int64)
        self._torques_n_m = np.empty((0, 2))
        self._halves_n_m = np.empty(0)

    def changing(self, estimate: Estimate, lever_m: float, stamp_ns: int) -> bool:
        """Whether the moment of the contact has changed by more than its interval just now.

        `lever_m` is from the arm's first joint to the contact: the moment of the force about it
        is continuous where the contact passes from one segment to the next.
        """
        angle = math.radians(estimate.angle_deg)
        size_n_m = estimate.magnitude_n * lever_m if estimate.segment else 0.0
        torque_n_m = size_n_m * np.array([math.sin(angle), math.cos(angle)])
        half_n = max(NORMAL_95 * estimate.magnitude_std_n, _LEAST_N)
        half_n_m = half_n * max(lever_m, 1e-3)
        passed_ns = stamp_ns - self._stamps_ns
        recent = (passed_ns >= 0) & (passed_ns <= _MOMENT_NS)
        torques_n_m = self._torques_n_m[recent]
        halves_n_m = self._halves_n_m[recent]
        apart_n_m = np.hypot(*(torques_n_m - torque_n_m).T)
        changed = bool((apart_n_m > halves_n_m + half_n_m).any())
        self._stamps_ns = np.append(self._stamps_ns[recent], stamp_ns)
        self._torques_n_m = np.vstack([torques_n_m, torque_n_m])
        self._halves_n_m = np.append(halves_n_m, half_n_m)
        return changed
