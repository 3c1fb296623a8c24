"""An arm of an arm file, as a commissioning moves it."""

from __future__ import annotations

import numpy as np

from cablesense_base import Array
from cablesense_contact.calibration import Calibration
from cablesense_contact.felt import torque_covariance_at_rest
from cablesense_contact.felt_arm import FeltArm
from cablesense_contact.law import Law
from cablesense_contact.reference_contacts import ReferenceContacts
from cablesense_online.breathing import tip_m
from cablesense_online.movable import DIRECTIONS, TAUT_SHARE, outward
from cablesense_sim import kinematics
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.uncertain_arm import cable_friction

_BEND_SHARE = 0.8
"""Joints stay within this share of the bend at which guide plates meet."""
_PREDICTION_STEPS = 6
"""Newton steps from the pretension to the reading in a pose."""
_PREDICTED_N = 0.01
"""Change of a reading that is too small to continue them."""


class MovableArm:
    """An arm that a commissioning moves: a `movable.Movable`; the law predicts its readings.

    Attributes:
        arm: its file.
    """

    per_radian = 1.0

    def __init__(self, arm: Arm, law: Law) -> None:
        self.arm = arm
        self.felt = FeltArm(arm)
        self.rubs = cable_friction(arm).listed
        self._law = law
        self._mechanism = mechanism_of(arm)
        self._start_n = np.full(arm.cable_count, float(arm.cables.pretension_n))
        self.taut_n: Array = TAUT_SHARE * self._start_n

    def candidates(self, count: int, reach_rad: float, rng: np.random.Generator) -> Array:
        """(K, 2N) the straight arm first; guide plates stay apart."""
        drawn = rng.uniform(-reach_rad, reach_rad, (count, self.arm.joint_count))
        drawn = outward(drawn, reach_rad)
        drawn[0] = 0.0
        limit_rad = _BEND_SHARE * self._mechanism.bend_limit_rad
        bend_rad = np.maximum(kinematics.bend_rad(drawn), 1e-9)
        shrink = np.minimum(1.0, limit_rad / bend_rad)
        return np.asarray(drawn * np.repeat(shrink, 2, axis=1))

    def predicted_n(self, commands: Array, calibration: Calibration) -> Array:
        """Readings (K, M) without a load at commands (K, 2N); of nearly slack cables too high."""
        reading_n = np.tile(self._start_n, (len(commands), 1))
        belief = (calibration.mean, calibration.covariance, torque_covariance_at_rest(self.felt))
        for _ in range(_PREDICTION_STEPS):
            change_n = -self._law(reading_n, commands, *belief).innovation_n
            # kept taut: where a cable is slack the law may not be solvable
            reading_n = np.maximum(reading_n + change_n, 0.5 * self.taut_n)
            if np.abs(change_n).max() < _PREDICTED_N:
                break
        return reading_n

    def beside(self, approach_rad: float) -> Array:
        """(2N,) turns by which every cable moves at every guide."""
        return approach_rad * approach_direction(self._mechanism)

    def farthest_m(self, start: Array, commands: Array) -> float:
        """How far the tip moves."""
        moved_m = tip_m(self._mechanism, commands) - tip_m(self._mechanism, start)
        return float(np.linalg.norm(moved_m, axis=-1).max())

    def reference_contacts(self) -> ReferenceContacts:
        """Across every segment, in several poses."""
        return ReferenceContacts.of_arm(self.arm)


def approach_direction(mechanism: Mechanism) -> Array:
    """(2N,) relative turns of the joints, at most 1, by which every cable moves at every guide."""
    rng = np.random.default_rng(0)
    count = mechanism.joint_count
    directions = rng.uniform(-1.0, 1.0, (DIRECTIONS, count))
    directions /= np.abs(directions).max(axis=1, keepdims=True)
    by_angle = kinematics.cable_jacobian_m(mechanism, np.zeros(count))
    by_joint = (by_angle * directions[:, None]).reshape(DIRECTIONS, mechanism.cable_count, -1, 2)
    # a cable moves at a guide by what the joints from there on take of it
    moved = np.abs(by_joint.sum(axis=3)[..., ::-1].cumsum(axis=2)[..., ::-1])
    least = np.where(mechanism.passes_joint, moved, np.inf).min(axis=(1, 2))
    return np.asarray(directions[least.argmax()])
