"""How tensions change where an arm at rest differs a little: to first order, without a search.

An arm that differs from another one is not balanced in the other's equilibrium. With the torques τ
that are left there it turns by -H⁻¹ τ, H the second derivative of the potential. That is one step
of Newton's method, and costs a fifth of a search. Slack cables stay slack, and taut ones taut.
"""

from __future__ import annotations

import numpy as np

from cablesense_base import Array
from cablesense_sim import kinematics
from cablesense_sim.equilibrium import stiffness_matrix_n_m
from cablesense_sim.mechanism import Mechanism


class EquilibriumResponse:
    """B equilibria of one arm, and the tensions there of arms that differ a little from it."""

    def __init__(
        self, mechanism: Mechanism, equilibrium_rad: Array, tensions_n: Array, forces_n: Array
    ) -> None:
        """Equilibria (B, 2N) with tensions (B, M) under forces (B, N, 3) in base axes."""
        self._equilibrium_rad = equilibrium_rad
        self._taut = tensions_n > 0.0
        slope_n_m = stiffness_matrix_n_m(mechanism, equilibrium_rad, tensions_n, forces_n)
        self._turn_by_torque = np.linalg.inv(slope_n_m)
        self._by_turn_m = kinematics.cable_jacobian_m(mechanism, equilibrium_rad)
        pose = kinematics.chain(mechanism, equilibrium_rad)
        joint = np.arange(mechanism.joint_count) // 2
        moves = joint <= np.arange(mechanism.segment_count)[:, None]
        axis = pose.rotation[..., :, None, :, 0]
        turned = np.cross(pose.joint_axis[..., None, :, :], axis) * moves[..., None]
        count = mechanism.joint_count
        # (B, 2N, 3N): how the segments' axes move with each joint angle
        self._axes_by_turn = np.moveaxis(turned, -3, -2).reshape(len(equilibrium_rad), count, -1)

    def tensions_n(self, mechanism: Mechanism, held_m: Array, forces_n: Array) -> Array:
        """(B, M) of an arm whose actuators hold lengths (B, M), under forces (B, N, 3)."""
        spans = kinematics.spans(mechanism, self._equilibrium_rad)
        straight = kinematics.spans(mechanism, np.zeros(mechanism.joint_count))
        stretch_m = spans.length_m.sum(-1) - straight.length_m.sum(-1) - held_m
        stretch_m += mechanism.pretension_n / mechanism.stiffness_n_m
        stiffness_n_m = mechanism.stiffness_n_m * self._taut
        pulled_n = stiffness_n_m * stretch_m
        by_turn_m = np.stack([spans.by_pitch, spans.by_yaw], axis=-1)
        by_turn_m = by_turn_m.reshape(*pulled_n.shape, mechanism.joint_count)
        arms_n_m = kinematics.load_arms(mechanism, forces_n)
        torque_n_m = (pulled_n[:, None] @ by_turn_m)[:, 0]
        torque_n_m -= (self._axes_by_turn @ arms_n_m.reshape(len(held_m), -1, 1))[..., 0]
        torque_n_m += np.repeat(mechanism.joint_stiffness_n_m_rad, 2) * self._equilibrium_rad
        turn_rad = -self._turn_by_torque @ torque_n_m[..., None]
        stretch_m += (self._by_turn_m @ turn_rad)[..., 0]
        return np.asarray(stiffness_n_m * stretch_m)
