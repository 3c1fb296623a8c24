"""Kinematics in few tensor operations, for a graph that runs a thousand times a second.

A small ONNX graph costs what its operators' dispatch costs, and this needs thirty instead of the
three hundred of `cablesense_sim.kinematics`. With a = (1, cos, sin) of a joint's pitch and b of
its yaw, the joint's rotation `Ry Rz`, the squared cable spans and their derivatives are all linear
in the nine products a_i b_j, so constant matrices do the rest.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from cablesense_sim import kinematics
from cablesense_sim.mechanism import Mechanism

Matrix = NDArray[np.float64]

_DERIVATIVE = np.array([[0, 0, 0], [0, 0, 1], [0, -1, 0]], dtype=float)
"""d/dx (1, cos x, sin x) = (0, -sin x, cos x), as a matrix on coefficients."""

_LEVI_CIVITA = np.zeros((3, 3, 3))
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _LEVI_CIVITA[_i, _j, _k] = 1.0
    _LEVI_CIVITA[_k, _j, _i] = -1.0


def constant(value: NDArray[Any]) -> nn.Buffer:
    """Numbers of an arm that go with a network and are not trained."""
    return nn.Buffer(torch.as_tensor(np.ascontiguousarray(value)))


def _about(axis: int) -> Matrix:
    """Rotation about an axis as coefficients (3, 3, 3) of (1, cos, sin), by Rodrigues."""
    along = np.diag(np.eye(3)[axis])
    return np.stack([along, np.eye(3) - along, _LEVI_CIVITA[:, axis]], axis=-1)


class CompactPose(NamedTuple):
    """Kinematics at B poses of an arm with N segments and M cables.

    Attributes:
        length_m: (B, M) cable lengths, each but for a constant.
        jacobian_t_m: (B, 2N, M) transposed derivative of the cable lengths.
        frames: (B, 3, 3N + 3) base frame and segment frames side by side: x_0 y_0 z_0 x_1 y_1 …
    """

    length_m: Tensor
    jacobian_t_m: Tensor
    frames: Tensor


class CompactKinematics(nn.Module):
    """`CompactPose` of joint angles (B, 2N), and the torques that forces make there."""

    def __init__(self, mechanism: Mechanism) -> None:
        super().__init__()
        n = mechanism.segment_count
        self.segment_count = n
        self.cable_count = mechanism.cable_count
        rotation = np.einsum("kmi,mlj->ijkl", _about(1), _about(2))
        first, second = np.divmod(np.tile(np.arange(9), n), 3)
        joint, segment = np.repeat(np.arange(n), 9), np.arange(n)
        beyond = np.repeat(np.tril(np.ones((n, n))), 2, axis=1)
        self.trig_map = constant(np.kron(np.eye(2 * n), [0.0, 1.0, 1.0]))
        self.trig_shift = constant(np.tile([0.0, 0.0, -0.5 * np.pi], 2 * n))
        self.pitch_feature = constant(6 * joint + first)
        self.yaw_feature = constant(6 * joint + 3 + second)
        self.span_map = constant(_span_map(mechanism, rotation).T)
        self.rotation_map = constant(_rotation_map(n, rotation).T)
        self.joint_axes = constant((3 * segment[:, None] + [1, 5]).ravel())
        self.segment_axes = constant(3 * (segment + 1))
        self.cross = constant(_LEVI_CIVITA.transpose(1, 0, 2).reshape(3, 9))
        self.gravity_cross = constant(np.einsum("ijk,j->ik", _LEVI_CIVITA, mechanism.gravity_m_s2))
        self.moment_kg_m = constant(beyond * _mass_moments_kg_m(mechanism)[:, None])
        self.centre_map = constant(_centre_map(mechanism))
        self.beyond = constant(beyond[:, None])

    def forward(self, joint_angles_rad: Tensor) -> CompactPose:
        """See `CompactPose`."""
        n, m = self.segment_count, self.cable_count
        trig = torch.cos(joint_angles_rad @ self.trig_map + self.trig_shift)
        pitch, yaw = (trig.index_select(1, f) for f in (self.pitch_feature, self.yaw_feature))
        features = pitch * yaw
        squared, slopes = (features @ self.span_map).split([n * m, 2 * n * m], dim=1)
        span = torch.sqrt(squared).reshape(-1, n, 1, m)
        joints = (features @ self.rotation_map).reshape(-1, n + 1, 3, 3).split(1, dim=1)
        frames = [joints[0], joints[1]]
        for turn in joints[2:]:
            frames.append(frames[-1] @ turn)
        return CompactPose(
            length_m=span.sum((1, 2)),
            jacobian_t_m=(slopes.reshape(-1, n, 2, m) / span).reshape(-1, 2 * n, m),
            frames=torch.cat(frames, dim=-1).reshape(-1, 3, 3 * n + 3),
        )

    def weight_n_m(self, pose: CompactPose) -> Tensor:
        """(B, 2N) joint torques of the arm's weight.

        The torque on axis w of a force e at distance r is w · (r x e) = r · (e x w).
        """
        joints, along = self._axes(pose)
        return ((self.gravity_cross @ joints) * (along @ self.moment_kg_m)).sum(1)

    def levers(self, pose: CompactPose, frames: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(B, N, 3, 2N) torques of unit forces at the joint centres, and their slope by the place.

        Forces are along the axes of other `frames` (B, 3, 3N + 3), places along those of the pose.
        Third are the torques (B, N, 2N) of unit moments about the segments' axes of the pose.
        """
        n = self.segment_count
        joints, along = self._axes(pose)
        axes = frames[:, :, 3:].transpose(1, 2)
        crossed = (axes @ self.cross).reshape(-1, 3 * n, 3, 3).transpose(1, 2)
        turned = (crossed.reshape(-1, 9 * n, 3) @ joints).reshape(-1, 3, n, 3, 2 * n)
        centres = (along @ self.centre_map).reshape(-1, 3, n, 1, 2 * n)
        outward = along.reshape(-1, 3, n, 1, 1) * self.beyond
        twist = (along.transpose(1, 2) @ joints) * self.beyond[:, 0]
        return (turned * centres).sum(1), (turned * outward).sum(1), twist

    def _axes(self, pose: CompactPose) -> tuple[Tensor, Tensor]:
        """Axes (B, 3, 2N) of the joints, and (B, 3, N) along the segments."""
        joints = pose.frames.index_select(2, self.joint_axes)
        return joints, pose.frames.index_select(2, self.segment_axes)


def _span_map(mechanism: Mechanism, rotation: Matrix) -> Matrix:
    """(3 · N · M, 9N): features to squared spans, then to halves of their derivatives.

    Derivatives are ordered (joint, pitch or yaw, cable). A cable that does not pass a joint has
    span 1 there, which no derivative and no difference sees.
    """
    n, m = mechanism.segment_count, mechanism.cable_count
    squared_map, slope_map = np.zeros((n, m, n, 9)), np.zeros((n, 2, m, n, 9))
    for joint, passes in enumerate(mechanism.passes_joint.T):
        (y, z), (v, w) = (
            [axis[:, joint] for axis in plates] for plates in mechanism.plate_holes_m
        )
        o = np.full_like(y, mechanism.plate_offset_m)
        after, before = np.stack([o, v, w]), np.stack([-o, y, z])
        squared = -2.0 * np.einsum("km,ijkl,lm->ijm", before, rotation, after)
        squared[0, 0] += (after**2).sum(0) + (before**2).sum(0)
        by_pitch = 0.5 * np.einsum("ai,ijm->ajm", _DERIVATIVE, squared)
        by_yaw = 0.5 * np.einsum("bj,ijm->ibm", _DERIVATIVE, squared)
        absent = np.zeros_like(squared)
        absent[0, 0] = 1.0
        squared_map[joint, :, joint] = np.where(passes, squared, absent).reshape(9, m).T
        slopes = np.where(passes, np.stack([by_pitch, by_yaw]), 0.0)
        slope_map[joint, :, :, joint] = slopes.reshape(2, 9, m).transpose(0, 2, 1)
    return np.concatenate([squared_map.reshape(-1, 9 * n), slope_map.reshape(-1, 9 * n)])


def _rotation_map(segment_count: int, rotation: Matrix) -> Matrix:
    """(9 (N + 1), 9N): features to the identity and the joints' own rotations."""
    whole = np.zeros((segment_count + 1, 9, segment_count, 9))
    whole[0, :, 0, 0] = np.eye(3).ravel()
    for joint in range(segment_count):
        whole[joint + 1, :, joint] = rotation.reshape(9, 9).T
    return whole.reshape(9 * (segment_count + 1), 9 * segment_count)


def _mass_moments_kg_m(mechanism: Mechanism) -> Matrix:
    """(N,) first moments of the mass along each segment's axis, of all that it carries."""
    unit_weight = replace(mechanism, gravity_m_s2=np.array([0.0, 0.0, 1.0]))
    return kinematics.load_arms(unit_weight, np.zeros((mechanism.segment_count, 3)))[:, 2]


def _centre_map(mechanism: Mechanism) -> Matrix:
    """(N, N · 2N): segment axes to the vectors from each joint to each segment's joint centre."""
    n = mechanism.segment_count
    reach = np.zeros((n, n, n))
    for joint in range(n):
        for segment in range(joint, n):
            reach[joint:segment, segment, joint] = mechanism.segment_length_m[joint:segment]
    return np.repeat(reach, 2, axis=-1).reshape(n, 2 * n * n)
