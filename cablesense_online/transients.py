"""Forces that change faster than anything at rest can: a tap, a bumped table.

While the arm swings, its inertia is in the readings, and statics calls it a force. A statement is
confirmed once the force of the samples before, as long as the arm swings, lies in its interval.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_contact.estimate import Estimate

_HALF_SWING_NS = 150_000_000
"""An arm on cables swings with some 5 to 20 Hz; half a period of the slowest."""
_HALF_STD = 3.29
"""Half of the interval that holds 99.9 % of a normal number, in standard deviations. Two numbers
that differ by noise alone are farther apart than two such halves once in 300,000 pairs."""
_SHORTEST_LEVER_M = 1e-3
"""A contact nearer to the first joint counts as there."""


@dataclass(frozen=True)
class RecentTorques:
    """The torques of the contacts of the last samples about the arm's first joint.

    Attributes:
        stamps_ns: (K,) of the samples.
        torques_n_m: (K, 3) along two axes across the arm, and half of their 99.9 % interval.
    """

    stamps_ns: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    torques_n_m: Array = field(default_factory=lambda: np.empty((0, 3)))


def with_torque(
    before: RecentTorques, estimate: Estimate, lever_m: float, stamp_ns: int
) -> tuple[RecentTorques, bool]:
    """With the torque of another estimate, and whether it has changed just now.

    That is by more than both half intervals within `_HALF_SWING_NS`. `lever_m` is from the arm's
    first joint to the contact: the torque of the force about it is continuous where the contact
    passes from one segment to the next.
    """
    angle = math.radians(estimate.angle_deg)
    size_n_m = estimate.magnitude_n * lever_m if estimate.segment else 0.0
    y_n_m = size_n_m * math.sin(angle)
    z_n_m = size_n_m * math.cos(angle)
    half_n_m = _HALF_STD * estimate.magnitude_std_n * max(lever_m, _SHORTEST_LEVER_M)
    passed_ns = stamp_ns - before.stamps_ns
    is_recent = (passed_ns >= 0) & (passed_ns <= _HALF_SWING_NS)
    torques_n_m = before.torques_n_m[is_recent]
    earlier_y_n_m, earlier_z_n_m, earlier_half_n_m = torques_n_m.T
    apart_n_m = np.hypot(earlier_y_n_m - y_n_m, earlier_z_n_m - z_n_m)
    has_changed = bool((apart_n_m > earlier_half_n_m + half_n_m).any())
    recent = RecentTorques(
        np.concatenate([before.stamps_ns[is_recent], [stamp_ns]]),
        np.concatenate([torques_n_m, [[y_n_m, z_n_m, half_n_m]]]),
    )
    return recent, has_changed
