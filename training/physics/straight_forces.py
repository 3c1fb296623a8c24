"""Statics of the straight arm as one matrix: from tension differences to a force on every segment.

At rest J' ΔT = sum_n B_n' f_n holds, slack or not. Two unknown components on each of N segments meet 2N joint torques, so
on an arm that hardly gives way the forces follow linearly from the tensions, however many segments are touched:
f = A ΔT with A = (B')^-1 J' at the straight pose.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cablesense_sim import kinematics
from cablesense_sim.mechanism import Mechanism

Matrix = NDArray[np.float64]


def straight_force_matrix(mechanism: Mechanism) -> Matrix:
    """A (2N, M): rows are the y and z components of the force on segment 1, of that on segment 2, …"""
    straight = np.zeros(mechanism.joint_count)
    jacobian = kinematics.cable_jacobian_m(mechanism, straight)
    contact = kinematics.contact_jacobians_m(mechanism, straight)
    normal = kinematics.segment_rotations(mechanism, straight)[..., 1:]
    lever = np.einsum("nxc,nxj->ncj", normal, contact)
    lever = lever.reshape(mechanism.joint_count, mechanism.joint_count)
    forces: Matrix = np.linalg.solve(lever.T, jacobian.T)
    return forces
