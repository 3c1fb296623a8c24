"""Contacts at one pose of the arm: in base axes, at the joints, and behind several tensions.

A force in the plane normal to a segment at its contact point turns the joints by

    tau = A_n (f_y, f_z),   A_n = J_n(q)^T [y_n z_n]

with J_n the derivative of the contact point and y_n, z_n the segment's axes in the base frame.
Cables take it up: J(q)^T dT = sum_n A_n f_n, with J the derivative of their lengths. So the
directions of forces on all segments, two components each, follow from the torques of the joints.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cablesense_base import Array
from cablesense_msgs_py.messages import Contact
from cablesense_sim import kinematics
from cablesense_sim.mechanism import Mechanism


class ContactStatics:
    """What depends on the pose alone is computed when that changes."""

    def __init__(self, mechanism: Mechanism) -> None:
        self._mechanism = mechanism
        self._pose_rad: Array | None = None

    def at(self, pose_rad: Array) -> ContactStatics:
        """This object, of a pose (2N,)."""
        if pose_rad is not self._pose_rad:
            self._pose_rad, mechanism = pose_rad, self._mechanism
            axes = kinematics.segment_rotations(mechanism, pose_rad)[..., 1:]
            self._points_m = kinematics.contact_points_m(mechanism, pose_rad)
            self._axes = np.asarray(axes)
            moves = kinematics.contact_jacobians_m(mechanism, pose_rad)
            self._torques_m = np.swapaxes(moves, -1, -2) @ self._axes
            self._cables_m = kinematics.interleave(kinematics.spans(mechanism, pose_rad))
        return self

    def base_wrench(self, contacts: Sequence[Contact]) -> list[float]:
        """Force, N, and its moment about the origin of the base frame, N·m, of all (6,)."""
        wrench = np.zeros(6)
        for contact in contacts:
            force_n = contact.magnitude_n * self._axes[contact.segment - 1] @ contact.direction
            wrench[:3] += force_n
            wrench[3:] += np.cross(self._points_m[contact.segment - 1], force_n)
        return wrench.tolist()

    def joint_torques_n_m(self, contacts: Sequence[Contact]) -> list[float]:
        """How all together turn the joints (2N,)."""
        torques = np.zeros(self._mechanism.joint_count)
        for contact in contacts:
            torque_m = self._torques_m[contact.segment - 1] @ contact.direction
            torques += contact.magnitude_n * torque_m
        return torques.tolist()

    def angles_deg(self, difference_n: Array, segments: Sequence[int]) -> list[float]:
        """Contact angles of forces on segments, from 1 on, behind tension differences (M,)."""
        by_force = np.hstack([self._torques_m[number - 1] for number in segments])
        forces_n, *_ = np.linalg.lstsq(by_force, self._cables_m.T @ difference_n, rcond=None)
        y, z = forces_n.reshape(-1, 2).T
        return (np.rad2deg(np.arctan2(y, z)) % 360.0).tolist()
