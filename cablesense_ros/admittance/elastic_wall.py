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
        """How deep a point (3,) is in the wall that has advanced so far; negative outside."""
        return advance_m - float(self.normal @ (contact_point_m - self.point_m))


class WallPressing:
    """The wall's force from one look at the arm to the next.

    An arm that gives way by c metres a newton has already given way to the last force when it is
    looked at. To press with k p at once would overshoot by the factor k c and, from k c = 1 on,
    shake the arm. So each look takes a Newton step on F = k (p + c (F_last − F)), which for an arm
    at rest is exact; p may be negative where the last force has pushed the arm out of the wall.
    """

    def __init__(self, wall: ElasticWall, compliance_m_n: float) -> None:
        """`compliance_m_n` is the arm's c at the contact point, along the wall's normal."""
        self.wall = wall
        self._compliance_m_n = compliance_m_n
        self._depth_m = 0.0
        self.force_n = 0.0

    def look(self, contact_point_m: Array, advance_m: float, elapsed_s: float) -> Array:
        """The force (3,) in base axes from now on.

        Args:
            contact_point_m: (3,) where the arm's contact point is.
            advance_m: of the wall along its normal.
            elapsed_s: since the last look.
        """
        penetration = self.wall.penetration_m(contact_point_m, advance_m)
        depth = max(0.0, penetration)
        growth, self._depth_m = depth - self._depth_m, depth
        damping = self.wall.damping_n_s_m / elapsed_s if elapsed_s > 0.0 else 0.0
        stiffness = self.wall.stiffness_n_m
        if depth == 0.0 and self.force_n == 0.0:
            return np.zeros(3)
        asked_n = stiffness * penetration + damping * growth
        eased_n = (asked_n - self.force_n) / (1.0 + (stiffness + damping) * self._compliance_m_n)
        self.force_n = max(0.0, self.force_n + eased_n)
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
