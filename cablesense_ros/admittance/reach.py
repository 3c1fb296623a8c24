"""The joint angles that the controller may command: for each joint a disc about straight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablesense_sim.mechanism import Mechanism

Array = NDArray[np.float64]

PLATE_MARGIN_RAD = float(np.deg2rad(2.0))
"""How far the guide plates stay apart at least."""


@dataclass(frozen=True)
class Reach:
    """Discs √(pitch² + yaw²) ≤ radius, one a joint.

    A disc holds the bend of the joint below its radius, as √(pitch² + yaw²) is never less than the
    bend. Discs are convex, so the nearest point of a disc to a step's end is never against the
    step.

    Attributes:
        radius_rad: (N,) of each joint's disc.
    """

    radius_rad: Array

    @classmethod
    def of(cls, mechanism: Mechanism, limit_rad: float) -> Reach:
        """As far as `limit_rad`, but never so far that guide plates come near each other."""
        return cls(np.minimum(limit_rad, mechanism.bend_limit_rad - PLATE_MARGIN_RAD))

    def nearest(self, joint_angles_rad: Array) -> Array:
        """The nearest joint angles (2N,) within reach."""
        joints = joint_angles_rad.reshape(-1, 2)
        bent = np.linalg.norm(joints, axis=1)
        share = np.where(
            bent > self.radius_rad, self.radius_rad / np.maximum(bent, self.radius_rad), 1.0
        )
        return np.asarray((joints * share[:, None]).reshape(-1))

    def holds(self, joint_angles_rad: Array, slack_rad: float = 1e-9) -> bool:
        """Whether these joint angles (2N,) are within reach."""
        bent = np.linalg.norm(joint_angles_rad.reshape(-1, 2), axis=1)
        return bool((bent <= self.radius_rad + slack_rad).all())
