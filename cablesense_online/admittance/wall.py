"""An elastic wall that approaches, presses on one segment and never pulls.

`SampledLoop` closes the loop in statics, step by step: wall, arm in static equilibrium, an exact
estimate, and the law. Without dynamics and interruptions only what decides its stability is left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cablesense_base.arrays import Array
from cablesense_online.admittance.law import AdmittanceLaw, FeltForce
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

    def penetration_m(self, contact_point_m: Array, advance_m: float) -> float:
        """How deep a point (3,) is in the wall that has advanced so far; negative outside."""
        return advance_m - float(self.normal @ (contact_point_m - self.point_m))


class WallPressing:
    """The wall's force from one reading of the arm's pose to the next.

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


def contact_point_m(mechanism: Mechanism, joint_angles_rad: Array, segment: int) -> Array:
    """(3,) contact point of segment 1..N, base frame."""
    return np.asarray(kinematics.contact_points_m(mechanism, joint_angles_rad)[segment - 1])


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
    point = contact_point_m(mechanism, joint_angles_rad, segment)
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


_BALANCED_N = 1e-4
_MOST_LOOKS = 60


@dataclass(frozen=True)
class LoopRun:
    """What a run gave.

    Attributes:
        forces_n: (K+1,) true force of the wall before each of K steps and after the last.
        commands_rad: (K+1, 2N) commands beside them.
    """

    forces_n: Array
    commands_rad: Array


class SampledLoop:
    """One segment of one arm against one wall."""

    def __init__(
        self, mechanism: Mechanism, law: AdmittanceLaw, wall: ElasticWall, segment: int
    ) -> None:
        self._mechanism = mechanism
        self._law = law
        self._wall = wall
        self._segment = segment

    def run(self, home_rad: Array, advance_m: float, step_count: int, period_s: float) -> LoopRun:
        """Steps from home (2N,) on, against the wall at an advance; a step every `period_s`.

        Raises:
            EquilibriumError: the arm cannot rest under the wall's force.
        """
        compliance = compliance_m_n(self._mechanism, home_rad, self._segment, self._wall.normal)
        pressing = WallPressing(self._wall, compliance)
        command, forces, commands = home_rad, [], []
        for _ in range(step_count):
            force = self._rest(pressing, command, advance_m)
            forces.append(pressing.force_n)
            commands.append(command)
            command = self._law.step(command, home_rad, self._felt(command, force), period_s)
        self._rest(pressing, command, advance_m)
        return LoopRun(np.array([*forces, pressing.force_n]), np.array([*commands, command]))

    def _rest(self, pressing: WallPressing, command_rad: Array, advance_m: float) -> Array:
        """The wall's force (3,) once arm and wall are at rest together."""
        forces = np.zeros((self._mechanism.segment_count, 3))
        for _ in range(_MOST_LOOKS):
            before_n = pressing.force_n
            angles = solve_equilibrium(self._mechanism, command_rad, forces).joint_angles_rad
            point = contact_point_m(self._mechanism, angles, self._segment)
            forces[self._segment - 1] = pressing.look(point, advance_m, 0.0)
            if abs(pressing.force_n - before_n) <= _BALANCED_N:
                break
        return forces[self._segment - 1].copy()

    def _felt(self, command_rad: Array, force_n: Array) -> FeltForce | None:
        """An exact estimate: the part of the force that is normal to the segment."""
        axis = kinematics.segment_rotations(self._mechanism, command_rad)[self._segment - 1][:, 0]
        normal = force_n - axis * (axis @ force_n)
        return FeltForce(self._segment, np.asarray(normal)) if normal.any() else None
