"""How well an arm is known, in one number: the 95 % interval of a typical contact's force.

The contact pushes with `FORCE_N` in the middle of the last segment, across it, in some poses. At
readings with the inverse covariance W, by sensors and calibration, place s and force f have the
covariance (Aᵀ W A + P)⁻¹, where A is the derivative of readings by s and f, and P is what is known
of any contact: it is on its segment, and does not pull hard along it.
"""

from __future__ import annotations

import numpy as np

from cablesense_base import Array
from cablesense_contact.estimate import NORMAL_95
from cablesense_contact.law import Law
from cablesense_sim.arm import Arm, per_segment

FORCE_N = 20.0
_POSES = 4
_BEND_DEG = 8.0
_AXIAL_STD_N = 10.0
_LATERAL_STD_N = 100.0
_STEPS = 3
"""Of the search for the readings of the untouched arm."""


class TypicalContact:
    """A push in the middle of the last segment of an arm."""

    def __init__(self, arm: Arm, law: Law) -> None:
        self._law = law
        joints = arm.joint_count
        rng = np.random.default_rng(0)
        self._poses_rad = np.deg2rad(rng.uniform(-_BEND_DEG, _BEND_DEG, (_POSES, joints)))
        self._start_n = np.full((_POSES, arm.cable_count), float(arm.cables.pretension_n))
        self._unrest = np.zeros((joints, joints))
        length_m = float(per_segment(arm.segments.length_m, arm.segment_count)[-1])
        self._middle_m = 0.5 * length_m
        lateral = _LATERAL_STD_N**-2
        self._prior = np.diag([12.0 / length_m**2, _AXIAL_STD_N**-2, lateral, lateral])

    def known_to_n(self, mean: Array, covariance: Array) -> float | None:
        """Half of the 95 % interval of its force, N: the median of some poses and directions.

        `mean` (P,) and `covariance` (P, P) are those of the arm's parameters. None where cables
        would be slack, so that there is no such number.
        """
        reading_n = self._start_n
        for _ in range(_STEPS):
            seen = self._law(reading_n, self._poses_rad, mean, covariance, self._unrest)
            reading_n = np.maximum(reading_n - seen.innovation_n, 0.0)
        by_place = seen.by_place[:, -1]
        by_force = seen.at_joint_m[:, -1] + self._middle_m * by_place
        variances = []
        for axis in (1, 2):
            moved = FORCE_N * by_place[:, axis : axis + 1]
            levers = np.concatenate([moved, by_force], axis=1)
            change = seen.by_torque @ levers.transpose(0, 2, 1)
            precision = change.transpose(0, 2, 1) @ seen.information_n2 @ change + self._prior
            if not np.isfinite(precision).all():
                return None
            variances.append(np.linalg.inv(precision)[:, 1 + axis, 1 + axis])
        middle_n2 = float(np.median(variances))
        return NORMAL_95 * middle_n2**0.5 if middle_n2 > 0.0 else None
