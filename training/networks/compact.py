"""Kinematics in few tensor operations, for a graph that runs a thousand times a second.

A small ONNX graph costs what its operators' dispatch costs, so this says what
`cablesense_sim.kinematics` says in thirty operators instead of three hundred. With a = (1, cos,
sin) of a joint's pitch and b = (1, cos, sin) of its yaw, the nine products a_i b_j are features in
which the joint's rotation `Ry Rz`, the squared cable spans and their derivatives are all linear,
so constant matrices do the rest. In here vectors are columns (B, ·, 1), and joint angles and
torques are ordered *all pitches, then all yaws*.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

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


def _about(axis: int) -> Matrix:
    """Rotation about an axis as coefficients (3, 3, 3) of (1, cos, sin), by Rodrigues."""
    along = np.diag(np.eye(3)[axis])
    return np.stack([along, np.eye(3) - along, _LEVI_CIVITA[:, axis]], axis=-1)


class CompactPose(NamedTuple):
    """Kinematics at B poses of an arm with N segments and M cables.

    Attributes:
        span_m: (B, 1, N, M) cable spans across the joints; 1 where a cable does not pass.
        jacobian_t_m: (B, 2N, M) transposed derivative of the cable lengths.
        frames: (B, 3, 3N + 3) base frame and segment frames side by side: x_0 y_0 z_0 x_1 y_1 …
    """

    span_m: Tensor
    jacobian_t_m: Tensor
    frames: Tensor


class CompactKinematics(nn.Module):
    """`CompactPose` of joint angles (B, 2N, 1): pitches, then yaws."""

    trig_map: Tensor
    trig_shift: Tensor
    pitch_feature: Tensor
    yaw_feature: Tensor
    span_map: Tensor
    rotation_map: Tensor
    lever_map: Tensor
    joint_axes: Tensor
    segment_axes: Tensor
    normal_axes: Tensor
    cross: Tensor
    gravity: Tensor

    def __init__(self, mechanism: Mechanism) -> None:
        super().__init__()
        n = mechanism.segment_count
        self.segment_count = n
        self.cable_count = mechanism.cable_count
        rotation = np.einsum("kmi,mlj->ijkl", _about(1), _about(2))
        first, second = np.divmod(np.arange(9), 3)
        joint = np.repeat(np.arange(n), 9)
        segment = np.arange(n)
        for name, value in (
            ("trig_map", np.kron(np.eye(2 * n), [[0.0], [1.0], [1.0]])),
            ("trig_shift", np.tile([0.0, 0.0, -0.5 * np.pi], 2 * n)[:, None]),
            ("pitch_feature", 3 * joint + np.tile(first, n)),
            ("yaw_feature", 3 * (n + joint) + np.tile(second, n)),
            ("span_map", _span_map(mechanism, rotation)),
            ("rotation_map", _rotation_map(n, rotation)),
            ("lever_map", _lever_map(mechanism)),
            ("joint_axes", np.concatenate([3 * segment + 1, 3 * (segment + 1) + 2])),
            ("segment_axes", 3 * (segment + 1)),
            ("normal_axes", np.concatenate([[3 * s + 1, 3 * s + 2] for s in segment + 1])),
            ("cross", _LEVI_CIVITA.transpose(1, 0, 2).reshape(3, 9)),
            ("gravity", np.stack([mechanism.gravity_m_s2, np.zeros(3)])),
        ):
            self.register_buffer(name, torch.as_tensor(value))

    def forward(self, joint_angles_rad: Tensor) -> CompactPose:
        """See `CompactPose`."""
        n, m = self.segment_count, self.cable_count
        trig = torch.cos(self.trig_map @ joint_angles_rad + self.trig_shift)
        features = trig.index_select(1, self.pitch_feature) * trig.index_select(
            1, self.yaw_feature
        )
        spans = (self.span_map @ features).reshape(-1, 3, n, m)
        span = torch.sqrt(spans[:, :1])
        joints = (self.rotation_map @ features).reshape(-1, n + 1, 3, 3).split(1, dim=1)
        frames = [joints[0], joints[1]]
        for turn in joints[2:]:
            frames.append(frames[-1] @ turn)
        return CompactPose(
            span_m=span,
            jacobian_t_m=(spans[:, 1:] / span).reshape(-1, 2 * n, m),
            frames=torch.cat(frames, dim=-1).reshape(-1, 3, 3 * n + 3),
        )

    def normal_cross(self, pose: CompactPose) -> Tensor:
        """Cross products with the segments' y and z axes and with gravity: (B, 3 · 2(N + 1), 3).

        Rows are (component, segment, axis); the last segment's two axes are gravity's acceleration
        and nothing.
        """
        rows = 2 * self.segment_count + 2
        normals = pose.frames.index_select(2, self.normal_axes).transpose(1, 2)
        gravity = self.gravity + 0.0 * normals[:, :2]
        crossed = (torch.cat([normals, gravity], dim=1) @ self.cross).reshape(-1, rows, 3, 3)
        return crossed.transpose(1, 2).reshape(-1, 3 * rows, 3)

    def levers(self, pose: CompactPose, normal_cross: Tensor) -> tuple[Tensor, Tensor]:
        """Joint torques of unit normal forces at the contact points, and of the weight.

        They are (B, N, 2, 2N) and (B, 2N, 1).
        The torque on axis w of a force e at distance r is w · (r x e) = r · (e x w).
        """
        n = self.segment_count
        crossed = (normal_cross @ pose.frames.index_select(2, self.joint_axes)).reshape(
            -1, 3, n + 1, 2, 2 * n
        )
        reach = (pose.frames.index_select(2, self.segment_axes) @ self.lever_map).reshape(
            -1, 3, n + 1, 1, 2 * n
        )
        torques = (crossed * reach).sum(1)
        return torques[:, :n], torques[:, n, 0, :, None]


class AxialLevers(nn.Module):
    """Joint torques of forces along all axes of a segment, at its joint centre and by the place.

    Args:
        kinematics: of the arm.
        mechanism: the arm.
    """

    centre_map: Tensor
    beyond: Tensor

    def __init__(self, kinematics: CompactKinematics, mechanism: Mechanism) -> None:
        super().__init__()
        n = mechanism.segment_count
        self.segment_count = n
        reach = np.zeros((n, n, n))
        for joint in range(n):
            for segment in range(joint, n):
                reach[joint:segment, segment, joint] = mechanism.segment_length_m[joint:segment]
        centres = np.concatenate([reach, reach], axis=-1).reshape(n, 2 * n * n)
        beyond = np.tril(np.ones((n, n)))
        self.register_buffer("centre_map", torch.as_tensor(centres))
        self.register_buffer("beyond", torch.as_tensor(np.hstack([beyond, beyond])[:, None]))
        self.kinematics = kinematics

    def forward(self, pose: CompactPose, frames: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(B, N, 3, 2N) torques of unit forces at the joint centres, and their slope by the place.

        Forces are along the axes of other `frames` (B, 3, 3N + 3), places along those of the pose.
        Third are the torques (B, N, 2N) of unit moments about the segments' axes of the pose.
        """
        n = self.segment_count
        axes = frames[:, :, 3:].transpose(1, 2)
        crossed = (axes @ self.kinematics.cross).reshape(-1, 3 * n, 3, 3).transpose(1, 2)
        joints = pose.frames.index_select(2, self.kinematics.joint_axes)
        turned = (crossed.reshape(-1, 9 * n, 3) @ joints).reshape(-1, 3, n, 3, 2 * n)
        along = pose.frames.index_select(2, self.kinematics.segment_axes)
        centres = (along @ self.centre_map).reshape(-1, 3, n, 1, 2 * n)
        outward = along.reshape(-1, 3, n, 1, 1) * self.beyond
        twist = (along.transpose(1, 2) @ joints) * self.beyond[:, 0]
        return (turned * centres).sum(1), (turned * outward).sum(1), twist


def _span_map(mechanism: Mechanism, rotation: Matrix) -> Matrix:
    """(3 · N · M, 9N): features to squared span, and halves of its derivatives by pitch and yaw.

    A cable that does not pass a joint has span 1 there, which no derivative and no difference
    sees.
    """
    n, m = mechanism.segment_count, mechanism.cable_count
    holes = [
        [np.broadcast_to(axis, (m, n)) for axis in plates] for plates in mechanism.plate_holes_m
    ]
    whole = np.zeros((3, n, m, n, 9))
    for joint, passes in enumerate(mechanism.passes_joint.T):
        (y, z), (v, w) = ([axis[:, joint] for axis in plates] for plates in holes)
        o = np.full_like(y, mechanism.plate_offset_m)
        after, before = np.stack([o, v, w]), np.stack([-o, y, z])
        squared = -2.0 * np.einsum("km,ijkl,lm->ijm", before, rotation, after)
        squared[0, 0] += (after**2).sum(0) + (before**2).sum(0)
        by_pitch = 0.5 * np.einsum("ai,ijm->ajm", _DERIVATIVE, squared)
        by_yaw = 0.5 * np.einsum("bj,ijm->ibm", _DERIVATIVE, squared)
        absent = np.zeros_like(squared)
        absent[0, 0] = 1.0
        parts = np.stack([squared, by_pitch, by_yaw]).reshape(3, 9, -1)
        otherwise = np.stack([absent, 0.0 * absent, 0.0 * absent]).reshape(3, 9, -1)
        whole[:, joint, :, joint] = np.where(passes, parts, otherwise).transpose(0, 2, 1)
    return whole.reshape(3 * n * m, 9 * n)


def _rotation_map(segment_count: int, rotation: Matrix) -> Matrix:
    """(9 (N + 1), 9N): features to the identity and the joints' own rotations."""
    whole = np.zeros((segment_count + 1, 9, segment_count, 9))
    whole[0, :, 0, 0] = np.eye(3).ravel()
    for joint in range(segment_count):
        whole[joint + 1, :, joint] = rotation.reshape(9, 9).T
    return whole.reshape(9 * (segment_count + 1), 9 * segment_count)


def _lever_map(mechanism: Mechanism) -> Matrix:
    """(N, (N + 1) · 2N): segment axes to the vectors from each joint to each contact point.

    They are zero beyond the contact point. The last block gives the first moments of the mass that
    each joint carries, kg·m.
    """
    n = mechanism.segment_count
    reach = np.zeros((n, n + 1, n))
    unit_weight = replace(mechanism, gravity_m_s2=np.array([0.0, 0.0, 1.0]))
    mass_arm_kg_m = kinematics.load_arms(unit_weight, np.zeros((n, 3)))[:, 2]
    for joint in range(n):
        for segment in range(joint, n):
            reach[joint:segment, segment, joint] = mechanism.segment_length_m[joint:segment]
            reach[segment, segment, joint] = mechanism.contact_m[segment]
        reach[joint:, n, joint] = mass_arm_kg_m[joint:]
    return np.concatenate([reach, reach], axis=-1).reshape(n, (n + 1) * 2 * n)
