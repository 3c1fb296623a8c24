"""An elastic wall that approaches, presses on one segment and never pulls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ElasticWall:
    """A half space that pushes along its normal, F = max(0, k p + b ṗ) at penetration p > 0.

    Attributes:
        point_m: (3,) a point of the surface at advance 0, base frame.
        normal: (3,) unit vector out of the wall, towards the arm, base axes.
        stiffness_n_m: k.
        damping_n_s_m: b.
    """

    point_m: Array
    normal: Array
    stiffness_n_m: float
    damping_n_s_m: float = 0.0

    def penetration_m(self, contact_point_m: Array, advance_m: float) -> float:
        """How deep a point (3,) is in the wall that has advanced along its normal; 0 outside."""
        return max(0.0, advance_m - float(self.normal @ (contact_point_m - self.point_m)))

    def force_n(self, penetration_m: float, rate_m_s: float = 0.0) -> float:
        """Pressing force at a penetration that grows by `rate_m_s`; never negative."""
        if penetration_m <= 0.0:
            return 0.0
        return max(0.0, self.stiffness_n_m * penetration_m + self.damping_n_s_m * rate_m_s)


class WallPressing:
    """The wall's force from one look at the arm to the next.

    An arm that gives way by c metres a newton has already given way to the last force when it is
    looked at. To press with k p at once would overshoot by the factor k c and, from k c = 1 on,
    shake the arm. So each look takes a Newton step on F = k (p + c (F_last − F)), which for an arm
    at rest is exact.
    """

    def __init__(self, wall: ElasticWall, compliance_m_n: float) -> None:
        """`compliance_m_n` is the arm's c at the contact point, along the wall's normal."""
        self.wall = wall
        self._compliance_m_n = compliance_m_n
        self._penetration_m = 0.0
        self.force_n = 0.0

    def look(self, contact_point_m: Array, advance_m: float, elapsed_s: float) -> Array:
        """The force (3,) in base axes from now on.

        Args:
            contact_point_m: (3,) where the arm's contact point is.
            advance_m: of the wall along its normal.
            elapsed_s: since the last look.
        """
        penetration = self.wall.penetration_m(contact_point_m, advance_m)
        rate = (penetration - self._penetration_m) / elapsed_s if elapsed_s > 0.0 else 0.0
        stiffness = self.wall.stiffness_n_m
        if elapsed_s > 0.0:
            stiffness += self.wall.damping_n_s_m / elapsed_s
        asked_n = self.wall.force_n(penetration, rate)
        eased = (asked_n - self.force_n) / (1.0 + stiffness * self._compliance_m_n)
        self.force_n = max(0.0, self.force_n + eased) if penetration > 0.0 else 0.0
        self._penetration_m = penetration
        return self.force_n * self.wall.normal


class Approach:
    """How far the wall has advanced: at constant speed towards a target that may change."""

    def __init__(self, start_m: float, speed_m_s: float) -> None:
        self.advance_m = start_m
        self.speed_m_s = speed_m_s

    def towards(self, target_m: float, elapsed_s: float) -> float:
        """Let time pass; gives where the wall is then, m along its normal."""
        way = target_m - self.advance_m
        reach = self.speed_m_s * elapsed_s
        self.advance_m += float(np.clip(way, -reach, reach))
        return self.advance_m
