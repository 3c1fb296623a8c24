"""One step of an admittance in joint space: how far to move away from a contact.

The law is D q̇ + K (q − q_home) + friction = Jᵀ f with J the Jacobian of the contact point at the
commanded angles and f the environment's force. The friction is dry: it takes up the torque of
`deadband_n` along the contact. A step of length T is linearly implicit in the torque k |j|² Δ that
a wall of the worst expected stiffness k would lose during the step:

    (D/T + K) Δ + k j (jᵀ Δ) = τ max(0, 1 − deadband |j| / |τ|),   τ = j |f| − K (q − q_home),
    j = Jᵀ f / |f|.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_sim import kinematics
from cablesense_sim.mechanism import Mechanism

PLATE_MARGIN_RAD = float(np.deg2rad(2.0))  # guide plates stay apart by at least this
LONGEST_STEP_S = 1.0  # a step moves no farther than for this time, however long ago the last was
SMALLEST_STEP_RAD = float(np.deg2rad(0.002))  # a smaller step is not worth its settling time
ROUNDING_RAD = 1e-9


@dataclass(frozen=True)
class AdmittanceSettings:
    """Numbers of the law, of the trust in estimates, and of the cycle; also the node's parameters.

    Attributes:
        damping_n_m_s_rad: D of every joint axis.
        return_stiffness_n_m_rad: K of every joint axis; 0 never returns home.
        deadband_n: contact forces up to this one move nothing.
        worst_stiffness_n_m: k, the stiffest contact that is expected.
        step_limit_deg, speed_limit_deg_s: no joint turns farther in a step, nor faster on average.
        touch_n: a step towards home meets an unseen wall of the worst stiffness with at most this.
        joint_limit_deg: radius of each joint's disc of commands, √(pitch² + yaw²).
        stale_after_s: without a fresh estimate for this long the controller stops.
        resume_after_s: estimates must come for this long before they are trusted again.
        joint_speed_deg_s: peak speed of the joints towards a command, the same for all nodes.
        measure_s: estimates are averaged over this time.
        confirm_deg: no joint turns farther for a contact that is not confirmed in a second pose.
        confirm_s: how long the contact is measured in that pose.
        yield_s: after a command of another node none is sent for this long.
        await_command: send nothing before another node has commanded once.
    """

    damping_n_m_s_rad: float = 5.0
    return_stiffness_n_m_rad: float = 1.0
    deadband_n: float = 2.0
    worst_stiffness_n_m: float = 20_000.0
    step_limit_deg: float = 1.0
    speed_limit_deg_s: float = 5.0
    touch_n: float = 4.0
    joint_limit_deg: float = 10.0
    stale_after_s: float = 0.2
    resume_after_s: float = 1.0
    joint_speed_deg_s: float = 20.0
    measure_s: float = 0.1
    confirm_deg: float = 0.45
    confirm_s: float = 1.0
    yield_s: float = 2.0
    await_command: bool = False


class ContactForce(NamedTuple):
    """An estimated contact: a force (3,) in base axes, N, on segment `segment` (from 1)."""

    segment: int
    force_base_n: Array


class AdmittanceLaw:
    """Steps for one arm; `radius_rad` (N,) is how far each joint may be commanded to bend."""

    def __init__(self, mechanism: Mechanism, settings: AdmittanceSettings) -> None:
        self._mechanism = mechanism
        self.settings = settings
        limit_rad = np.deg2rad(settings.joint_limit_deg)
        self.radius_rad = np.minimum(limit_rad, mechanism.bend_limit_rad - PLATE_MARGIN_RAD)

    def step(
        self, command_rad: Array, home_rad: Array, contact: ContactForce | None, elapsed_s: float
    ) -> Array:
        """The next command (2N,), `elapsed_s` after the last; the same where no step is worth it.

        Without a contact the arm returns towards `home_rad` (2N,).
        """
        period_s = min(elapsed_s, LONGEST_STEP_S)
        away_rad = command_rad - home_rad
        if contact is None:
            step_rad = self._homeward(command_rad, away_rad, period_s)
        else:
            step_rad = self._yielding(command_rad, away_rad, contact, period_s)
        settings = self.settings
        limit_rad = np.deg2rad(min(settings.step_limit_deg, settings.speed_limit_deg_s * period_s))
        step_rad = step_rad * min(1.0, limit_rad / max(np.abs(step_rad).max(), 1e-12))
        target_rad = self.nearest(command_rad + step_rad)
        worth_it = np.abs(target_rad - command_rad).max() >= SMALLEST_STEP_RAD
        return target_rad if worth_it else command_rad

    def nearest(self, angles_rad: Array) -> Array:
        """The nearest joint angles (2N,) within reach; a disc never reverses a step."""
        joints = angles_rad.reshape(-1, 2)
        bend = np.linalg.norm(joints, axis=1)
        share = np.where(bend > self.radius_rad, self.radius_rad / np.maximum(bend, 1e-12), 1.0)
        return np.asarray((joints * share[:, None]).reshape(-1))

    def holds(self, angles_rad: Array) -> bool:
        """Whether joint angles (2N,) are within reach."""
        bend = np.linalg.norm(angles_rad.reshape(-1, 2), axis=1)
        return bool((bend <= self.radius_rad + ROUNDING_RAD).all())

    def _homeward(self, command_rad: Array, away_rad: Array, period_s: float) -> Array:
        step = -away_rad * (self.settings.return_stiffness_n_m_rad / self._diagonal(period_s))
        jacobians = kinematics.contact_jacobians_m(self._mechanism, command_rad)
        moved_m = float(np.linalg.norm(jacobians @ step, axis=-1).max())
        touching_n = self.settings.worst_stiffness_n_m * moved_m
        return step * min(1.0, self.settings.touch_n / max(touching_n, 1e-12))

    def _yielding(
        self, command_rad: Array, away_rad: Array, contact: ContactForce, period_s: float
    ) -> Array:
        settings = self.settings
        force_n = contact.force_base_n
        magnitude_n = max(float(np.linalg.norm(force_n)), 1e-12)
        lever_m = self._jacobian(command_rad, contact.segment).T @ (force_n / magnitude_n)
        torque = lever_m * magnitude_n - settings.return_stiffness_n_m_rad * away_rad
        size = np.linalg.norm(torque)
        friction = settings.deadband_n * np.linalg.norm(lever_m)
        if size <= friction:
            return np.zeros_like(command_rad)
        torque = torque * (1.0 - friction / size)
        diagonal = self._diagonal(period_s)
        stiffness_n_m = settings.worst_stiffness_n_m
        implicit = stiffness_n_m * float(lever_m @ torque)
        implicit /= diagonal + stiffness_n_m * float(lever_m @ lever_m)
        return (torque - lever_m * implicit) / diagonal

    def _jacobian(self, command_rad: Array, segment: int) -> Array:
        jacobians: Array = kinematics.contact_jacobians_m(self._mechanism, command_rad)
        return jacobians[segment - 1]  # (3, 2N), of the contact point

    def _diagonal(self, period_s: float) -> float:
        settings = self.settings
        return settings.damping_n_m_s_rad / max(period_s, 1e-6) + settings.return_stiffness_n_m_rad
