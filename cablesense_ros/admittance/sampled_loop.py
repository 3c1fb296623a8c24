"""The closed loop in statics: wall, arm at rest, an exact estimate, and the law, step by step.

Nothing swings and nothing is blind here: what is left is what decides whether the loop is stable.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablesense_ros.admittance.admittance_law import AdmittanceLaw, FeltForce
from cablesense_ros.admittance.arm_contact import compliance_m_n, contact_point_m
from cablesense_ros.admittance.elastic_wall import ElasticWall, WallPressing
from cablesense_sim import kinematics
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.mechanism import Mechanism

Array = NDArray[np.float64]

_BALANCED_N = 1e-4
_MOST_LOOKS = 60


@dataclass(frozen=True)
class LoopCourse:
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

    def run(
        self, home_rad: Array, advance_m: float, step_count: int, period_s: float
    ) -> LoopCourse:
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
        return LoopCourse(np.array([*forces, pressing.force_n]), np.array([*commands, command]))

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
        """What an exact estimator says: the part of the force that is normal to the segment."""
        axis = kinematics.segment_rotations(self._mechanism, command_rad)[self._segment - 1][:, 0]
        normal = force_n - axis * (axis @ force_n)
        return FeltForce(self._segment, np.asarray(normal)) if normal.any() else None
