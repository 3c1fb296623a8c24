"""An elastic wall that approaches, presses on one segment and never pulls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cablesense_base import Array
from cablesense_sim import kinematics
from cablesense_sim.equilibrium import solve_equilibrium, stiffness_matrix_n_m
from cablesense_sim.loads import normal_force_n
from cablesense_sim.mechanism import Mechanism


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


class WallPressing:
    """The wall's force from one reading of the arm's pose to the next.

    An arm of compliance c has already given way to the last force when its pose is read. To press
    with k p at once would overshoot by the factor k c and, from k c = 1 on, shake the arm. So each
    update takes a Newton step on F = k (p + c (F_last − F)), which for an arm at rest is exact;
    p may be negative where the last force has pushed the arm out of the wall.
    """

    def __init__(self, wall: ElasticWall, compliance_m_n: float) -> None:
        """`compliance_m_n` is the arm's c at the contact point, along the wall's normal."""
        self.wall = wall
        self._compliance_m_n = compliance_m_n
        self._depth_m = 0.0
        self.force_n = 0.0

    def update(self, contact_point_m: Array, advance_m: float, elapsed_s: float) -> Array:
        """The force (3,) in base axes from now on, `elapsed_s` after the last update.

        `contact_point_m` (3,) is the arm's; `advance_m` the wall's, along its normal.
        """
        penetration = advance_m - float(self.wall.normal @ (contact_point_m - self.wall.point_m))
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


def wall_beside(
    mechanism: Mechanism,
    joint_angles_rad: Array,
    segment: int,
    angle_deg: float,
    stiffness_n_m: float,
    damping_n_s_m: float,
) -> ElasticWall:
    """A wall whose surface, at advance 0, just touches a segment's contact point.

    It pushes normal to the segment at these joint angles (2N,), at `angle_deg` from the segment's
    +z towards its +y.

    Raises:
        LoadError: no such segment, or an angle that is not finite.
    """
    push = normal_force_n(mechanism, joint_angles_rad, segment, angle_deg, 1.0)
    point = np.asarray(kinematics.contact_points_m(mechanism, joint_angles_rad)[segment - 1])
    return ElasticWall(point, push[segment - 1], stiffness_n_m, damping_n_s_m)


def compliance_m_n(
    mechanism: Mechanism, command_rad: Array, segment: int, direction: Array
) -> float:
    """How far a segment's contact point gives way along a unit vector (3,), m/N, unloaded.

    Raises:
        EquilibriumError: the arm has no rest at this command (2N,).
    """
    rest = solve_equilibrium(mechanism, command_rad)
    angles, none = rest.joint_angles_rad, np.zeros((mechanism.segment_count, 3))
    stiffness = stiffness_matrix_n_m(mechanism, angles, rest.tensions_n, none)
    lever = kinematics.contact_jacobians_m(mechanism, angles)[segment - 1].T @ direction
    return float(lever @ np.linalg.solve(stiffness, lever))
