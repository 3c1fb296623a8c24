"""The noise bound of contacts: the derivative of tensions by them, and the information in it.

No unbiased estimate of a contact has a covariance below the inverse of the information (Kay,
Fundamentals of Statistical Signal Processing, vol. I, 1993, section 3.8).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablesense_base import Array
from cablesense_sim import kinematics
from cablesense_sim.equilibrium import held_lengths_m, solve_equilibrium, stiffness_matrix_n_m
from cablesense_sim.mechanism import Mechanism


def contact_information(
    mechanism: Mechanism,
    command_rad: ArrayLike,
    segment: NDArray[np.int64],
    place_m: Array,
    force_n: Array,
    variance_n2: float,
) -> Array:
    """Fisher information (B, 4, 4) that tensions have of (f_x, f_y, f_z, place) of contacts.

    Commands are (B, 2N), segments (B,) from 1 on, places (B,) and forces (B, 3) along the axes of
    the segment at the commanded angles; `variance_n2` is that of one tension difference. Its
    inverse is the Cramér-Rao bound of unbiased estimates (Kay, Fundamentals of Statistical Signal
    Processing, vol. I, 1993). The information of what a pose does not show is zero.

    Raises:
        EquilibriumError: the arm has no equilibrium under one of the contacts.
    """
    command = np.asarray(command_rad, dtype=float)
    elastic_n, gain = contact_response(
        mechanism, command, segment[:, None], place_m[:, None], force_n[:, None]
    )
    gain = gain * (elastic_n > 0.0)[..., None]
    return np.asarray(np.swapaxes(gain, 1, 2) @ gain / variance_n2)


def contact_response(
    mechanism: Mechanism,
    command_rad: Array,
    segments: NDArray[np.int64],
    places_m: Array,
    forces_n: Array,
    held_m: Array | None = None,
) -> tuple[Array, Array]:
    """Tensions under K contacts each, and their derivative by the contacts' numbers.

    Commands are (B, 2N), segments (B, K) from 1 on and different, places (B, K). Forces (B, K, 3)
    are along the axes of the segments at the commanded angles; `solve_equilibrium` describes the
    held lengths. Tensions are (B, M), negative where a slack cable lacks length; the derivative
    (B, M, 4K) by (f_x, f_y, f_z, place) of each is that of a cable if it is taut.

    Raises:
        EquilibriumError: the arm has no equilibrium under the contacts of a sample.
    """
    rows = np.arange(len(segments))[:, None]
    n = segments - 1
    axes = kinematics.segment_rotations(mechanism, command_rad)
    at_m = np.tile(mechanism.contact_m, (len(n), 1))
    at_m[rows, n] = places_m
    forces = np.zeros((len(n), mechanism.segment_count, 3))
    forces[rows, n] = (axes[rows, n] @ forces_n[..., None])[..., 0]
    touched = replace(mechanism, contact_m=at_m)
    equilibrium = solve_equilibrium(touched, command_rad, forces, held_m=held_m)
    angles = equilibrium.joint_angles_rad
    at_joint, slope = (
        each[rows, n] for each in kinematics.contact_torques(mechanism, angles, axes)
    )
    by_force = at_joint + places_m[..., None, None] * slope
    by_place = forces_n[:, :, None] @ slope
    columns = np.concatenate([by_force, by_place], axis=2)
    columns = columns.reshape(len(n), -1, mechanism.joint_count)
    hessian = stiffness_matrix_n_m(touched, angles, equilibrium.tensions_n, forces)
    moved = np.linalg.solve(hessian, np.swapaxes(columns, 1, 2))
    jacobian = kinematics.cable_jacobian_m(mechanism, angles)
    if held_m is None:
        held_m = held_lengths_m(mechanism, command_rad)
    stretch_m = held_lengths_m(mechanism, angles) - held_m
    elastic_n = mechanism.pretension_n + mechanism.stiffness_n_m * stretch_m
    return elastic_n, np.asarray(mechanism.stiffness_n_m[:, None] * (jacobian @ moved))
