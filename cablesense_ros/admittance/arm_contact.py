"""Where a wall meets the arm, and how far the arm gives way there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cablesense_ros.admittance.elastic_wall import ElasticWall
from cablesense_sim import kinematics
from cablesense_sim.equilibrium import solve_equilibrium, stiffness_matrix_n_m
from cablesense_sim.loads import normal_force_n
from cablesense_sim.mechanism import Mechanism

Array = NDArray[np.float64]


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
