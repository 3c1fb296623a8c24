"""Contacts at one pose of the arm, as a controller takes them: in base axes and at the joints."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from cablesense_base import Array
from cablesense_msgs_py.messages import Contact
from cablesense_sim import kinematics
from cablesense_sim.mechanism import Mechanism


class ContactPose(NamedTuple):
    """Where a contact is in base axes, and how well that is known.

    Attributes:
        point_m: (3,) on the segment's axis.
        quaternion: (4,) x, y, z, w: its x axis points along the normal force, its z axis along the
            segment.
        covariance: (36,) by rows, of the point, m², and of turns about base axes, rad².
    """

    point_m: list[float]
    quaternion: list[float]
    covariance: list[float]


class ContactStatics:
    """Contacts at one pose of the arm, in base axes and at the joints.

    A contact on segment n with the force f and the moment m about the joint centre, in the
    segment's axes, makes the joint torques A_n' f + B_n' (m x e) with e the segment's x axis, A_n
    the torques of unit forces at the joint centre and B_n their slope by the place.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self._mechanism = mechanism
        self._pose_rad: Array | None = None

    def at(self, pose_rad: Array) -> ContactStatics:
        """This object at a pose (2N,)."""
        if pose_rad is not self._pose_rad:
            self._pose_rad, mechanism = pose_rad, self._mechanism
            self._axes = kinematics.segment_rotations(mechanism, pose_rad)
            at_joints = replace(mechanism, contact_m=np.zeros(mechanism.segment_count))
            self._joints_m = kinematics.contact_points_m(at_joints, pose_rad)
            torques = kinematics.contact_torques(mechanism, pose_rad, self._axes)
            self._by_force_m, self._by_place = torques
        return self

    def base_wrench(self, contacts: Sequence[Contact]) -> list[float]:
        """(6,) force, N, and moment about the base frame's origin, N·m, of all contacts."""
        wrench = np.zeros(6)
        for contact in contacts:
            n = contact.segment - 1
            force_n, moment_n_m = np.reshape(contact.wrench, (2, 3)) @ self._axes[n].T
            wrench[:3] += force_n
            wrench[3:] += moment_n_m + np.cross(self._joints_m[n], force_n)
        return wrench.tolist()

    def joint_torques_n_m(self, contacts: Sequence[Contact]) -> list[float]:
        """(2N,) torques of all contacts at the joints."""
        torques = np.zeros(self._mechanism.joint_count)
        for contact in contacts:
            n, (_, about_y, about_z) = contact.segment - 1, contact.wrench[3:]
            torques += contact.wrench[:3] @ self._by_force_m[n]
            torques += np.array([0.0, about_z, -about_y]) @ self._by_place[n]
        return torques.tolist()

    def contact_pose(
        self, contact: Contact, place_std_m: float, angle_std_deg: float
    ) -> ContactPose:
        """The pose of a contact whose place and angle have these standard deviations.

        The place varies along the segment's axis, the direction about it.
        """
        n, (y, z) = contact.segment - 1, contact.direction
        axes = self._axes[n]
        along = axes[:, 0]
        turn = axes @ np.array([[0.0, 0.0, 1.0], [y, -z, 0.0], [z, y, 0.0]])
        covariance = np.zeros((6, 6))
        covariance[:3, :3] = np.outer(along, along) * place_std_m**2
        covariance[3:, 3:] = np.outer(along, along) * math.radians(angle_std_deg) ** 2
        return ContactPose(
            (self._joints_m[n] + contact.contact_m * along).tolist(),
            Rotation.from_matrix(turn).as_quat().tolist(),
            covariance.ravel().tolist(),
        )
