"""The torques of the segments' weight, and how they follow pose and parameters."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from cablesense_sim.mechanism import Mechanism
from cablesense_training.law.geometry import LEVI_CIVITA, Matrix, SegmentFrames, constant
from cablesense_training.law.parameters import Parameters, gravity_by_tilt


class Weighed(NamedTuple):
    """The weight of the segments.

    Attributes:
        torque: (B, 1, 2N) on the joints.
        by_pose: (B, 2N, 2N) its derivative by the joint angles.
        by_parameter: (B, 2N, 5N + 2) by the numbers of the bodies and the tilt.
    """

    torque: Tensor
    by_pose: Tensor
    by_parameter: Tensor


class SegmentWeight(nn.Module):
    """`Weighed` of the segments of an arm at the frames that they have."""

    def __init__(self, mechanism: Mechanism) -> None:
        super().__init__()
        count = mechanism.segment_count
        self.segment_count = count
        self.cross = constant(LEVI_CIVITA.reshape(3, 9))
        self.is_length = constant((np.arange(5 * count) >= count).astype(float))
        self.moment_slopes = constant(_first_moment_slopes(mechanism))
        self.gravity_by_tilt = constant(gravity_by_tilt(mechanism))
        self.until = constant(np.triu(np.ones((2 * count, 2 * count))))
        self.after = constant(np.tril(np.ones((2 * count, 2 * count)), -1))

    def forward(self, frames: SegmentFrames, given: Parameters) -> Weighed:
        """What the segments weigh."""
        joints = 2 * self.segment_count
        slopes = (given.bodies @ self.moment_slopes).reshape(3 * self.segment_count, -1)
        # first moments of mass, which are linear in the centres and lengths
        moments = (slopes @ (given.bodies * self.is_length))[None]
        by_moment = (given.gravity_m_s2 @ frames.levers).flatten(2)
        by_gravity = (moments @ frames.levers.flatten(2)).reshape(-1, 3, joints)
        # joint k turns what joint j <= k carries: g · w_j x (w_k x r) = (g x w_j) · (w_k x r)
        turned = (given.gravity_m_s2 @ self.cross).reshape(3, 3) @ by_gravity
        turned = frames.joint_axes.transpose(1, 2) @ turned
        by_pose = turned * self.until + turned.transpose(1, 2) * self.after
        by_masses = by_moment.transpose(1, 2) @ slopes
        by_tilt = by_gravity.transpose(1, 2) @ self.gravity_by_tilt.T
        return Weighed(moments @ by_moment, by_pose, torch.cat([by_masses, by_tilt], dim=2))


def _first_moment_slopes(mechanism: Mechanism) -> Matrix:
    """(5N, 3N · 5N): numbers of bodies to the derivatives of first moments by their parameters.

    A segment has the first moments m x + l Σ m of those that it carries, m y and m z; the
    parameters of masses are shares.
    """
    count = mechanism.segment_count
    carried = np.triu(np.ones((count, count)), 1)
    slopes = np.zeros((5, count, 3, count, 5, count))
    mass, x, length, y, z = range(5)
    for n in range(count):
        for axis, centre in enumerate((x, y, z)):
            slopes[centre, n, axis, n, mass, n] = mechanism.mass_kg[n]
            slopes[mass, n, axis, n, centre, n] = 1.0
        slopes[length, n, 0, n, mass] = carried[n] * mechanism.mass_kg
        slopes[mass, :, 0, n, length, n] = carried[n]
    return slopes.reshape(5 * count, -1)
