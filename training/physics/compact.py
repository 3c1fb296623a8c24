"""Kinematics in few tensor operations, for a graph that runs a thousand times a second.

A small ONNX graph costs what its operators' dispatch costs, so this says what `cablesense_sim.kinematics` says in about
forty operators instead of four hundred. With a = (1, cos, sin) of a joint's pitch and b = (1, cos, sin) of its yaw, the
nine products a_i b_j are features in which the joint's rotation `Ry Rz`, the squared cable spans and their derivatives
are all linear. Joint angles and joint torques are ordered *all pitches, then all yaws* in here.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from cablesense_sim import kinematics
from cablesense_sim.mechanism import Mechanism

_PITCH = np.array(
    [
        [[0, 0, 0], [0, 1, 0], [0, 0, 0]],
        [[1, 0, 0], [0, 0, 0], [0, 0, 1]],
        [[0, 0, 1], [0, 0, 0], [-1, 0, 0]],
    ],
    dtype=float,
)
"""Rotation about y as coefficients of (1, cos, sin)."""

_YAW = np.array(
    [
        [[0, 0, 0], [0, 0, 0], [0, 0, 1]],
        [[1, 0, 0], [0, 1, 0], [0, 0, 0]],
        [[0, -1, 0], [1, 0, 0], [0, 0, 0]],
    ],
    dtype=float,
)
"""Rotation about z as coefficients of (1, cos, sin)."""

_DERIVATIVE = np.array([[0, 0, 0], [0, 0, 1], [0, -1, 0]], dtype=float)
"""d/dx (1, cos x, sin x) = (0, -sin x, cos x), as a matrix on coefficients."""

_LEVI_CIVITA = np.zeros((3, 3, 3))
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _LEVI_CIVITA[_i, _j, _k] = 1.0
    _LEVI_CIVITA[_k, _j, _i] = -1.0


class Pose(NamedTuple):
    """Kinematics at B poses.

    Attributes:
        span_sum_m: (B, M) summed cable spans, to a constant.
        jacobian_t_m: (B, 2N, M) transposed derivative of the cable lengths.
        rotations: (B, 3, 3N) segment frames side by side: x_1 y_1 z_1 x_2 …
        joint_axes: (B, 3, 2N) unit axes of the joint angles.
        gravity_n_m: (B, 2N) joint torques of the weight.
    """

    span_sum_m: Tensor
    jacobian_t_m: Tensor
    rotations: Tensor
    joint_axes: Tensor
    gravity_n_m: Tensor


class CompactKinematics(nn.Module):
    """`Pose` of joint angles (B, 2, N): pitches, then yaws."""

    span_map: Tensor
    rotation_map: Tensor
    gravity_map: Tensor
    lever_map: Tensor
    trig_scale: Tensor
    trig_shift: Tensor
    cross: Tensor

    def __init__(self, mechanism: Mechanism) -> None:
        super().__init__()
        self.segment_count = mechanism.segment_count
        self.cable_count = mechanism.cable_count
        rotation = np.einsum("ikm,jml->ijkl", _PITCH, _YAW)
        for name, value in (
            ("span_map", _span_map(mechanism, rotation)),
            ("rotation_map", rotation.reshape(9, 9)),
            ("gravity_map", _gravity_map(mechanism)),
            ("lever_map", _lever_map(mechanism)),
            ("trig_scale", np.array([0.0, 1.0, 1.0])),
            ("trig_shift", np.array([0.0, 0.0, -0.5 * np.pi])),
            ("cross", _LEVI_CIVITA.transpose(1, 0, 2).reshape(3, 9)),
        ):
            self.register_buffer(name, torch.as_tensor(value))

    def forward(self, joint_angles_rad: Tensor) -> Pose:
        """See `Pose`."""
        n, m = self.segment_count, self.cable_count
        trig = torch.cos(joint_angles_rad[..., None] * self.trig_scale + self.trig_shift)
        features = (trig[:, 0, :, :, None] * trig[:, 1, :, None, :]).reshape(-1, n, 1, 9)
        spans = (features @ self.span_map).reshape(-1, n, 3, m)
        length = torch.sqrt(spans[:, :, :1])
        jacobian_t = (spans[:, :, 1:] / length).transpose(1, 2).reshape(-1, 2 * n, m)
        rotations, axes = self._chain((features @ self.rotation_map).reshape(-1, n, 3, 3))
        moment = (rotations[:, :, 0::3].reshape(-1, 3 * n) @ self.gravity_map).reshape(
            -1, 3, 2 * n
        )
        return Pose(
            span_sum_m=length.sum((1, 2)),
            jacobian_t_m=jacobian_t,
            rotations=rotations,
            joint_axes=axes,
            gravity_n_m=(axes * moment).sum(1),
        )

    def _chain(self, joints: Tensor) -> tuple[Tensor, Tensor]:
        """Segment frames (B, 3, 3N) and joint axes (B, 3, 2N) from the joints' own rotations (B, N, 3, 3)."""
        frame = joints[:, 0]
        frames = [frame]
        for n in range(1, self.segment_count):
            frame = frame @ joints[:, n]
            frames.append(frame)
        base = torch.eye(3, dtype=joints.dtype) + 0.0 * frame
        rotations = torch.cat(frames, dim=-1)
        before = torch.cat([base, *frames[:-1]], dim=-1)
        return rotations, torch.cat([before[:, :, 1::3], rotations[:, :, 2::3]], dim=-1)

    def normal_cross(self, rotations: Tensor) -> Tensor:
        """Cross products with the segments' y and z axes: (B, 3 · 2N, 3), rows (component, segment, axis)."""
        n = self.segment_count
        normals = rotations.reshape(-1, 3, n, 3)[..., 1:].permute(0, 2, 3, 1).reshape(-1, 2 * n, 3)
        return (normals @ self.cross).reshape(-1, 2 * n, 3, 3).transpose(1, 2).reshape(
            -1, 6 * n, 3
        )

    def levers(self, pose: Pose, normal_cross: Tensor) -> Tensor:
        """Joint torques (B, N, 2, 2N) of unit forces at the contact points, along given normals.

        The torque on axis w of a force e at distance r is w · (r x e) = r · (e x w).
        """
        n = self.segment_count
        crossed = (normal_cross @ pose.joint_axes).reshape(-1, 3, n, 2, 2 * n)
        reach = (pose.rotations[:, :, 0::3] @ self.lever_map).reshape(-1, 3, n, 1, 2 * n)
        return (crossed * reach).sum(1)


def _span_map(mechanism: Mechanism, rotation: np.ndarray) -> np.ndarray:
    """(N, 9, 3M): features to squared span, and halves of its derivatives by pitch and yaw.

    A cable that does not pass a joint has span 1 there, which no derivative and no difference sees.
    """
    o, y, z = mechanism.plate_offset_m, mechanism.hole_y_m, mechanism.hole_z_m
    after = np.stack([np.full_like(y, o), y, z])
    before = np.stack([np.full_like(y, -o), y, z])
    squared = -2.0 * np.einsum("km,ijkl,lm->ijm", before, rotation, after)
    squared[0, 0] += (after**2).sum(0) + (before**2).sum(0)
    by_pitch = 0.5 * np.einsum("ai,ijm->ajm", _DERIVATIVE, squared)
    by_yaw = 0.5 * np.einsum("bj,ijm->ibm", _DERIVATIVE, squared)
    absent = np.zeros_like(squared)
    absent[0, 0] = 1.0
    nothing = np.zeros_like(squared)
    maps = []
    for passes in mechanism.passes_joint.T:
        parts = [
            np.where(passes, part, otherwise).reshape(9, -1)
            for part, otherwise in ((squared, absent), (by_pitch, nothing), (by_yaw, nothing))
        ]
        maps.append(np.concatenate(parts, axis=1))
    return np.stack(maps)


def _gravity_map(mechanism: Mechanism) -> np.ndarray:
    """(3N, 3 · 2N): segment axes to the moments that each joint carries, rows (component, segment)."""
    n = mechanism.segment_count
    arms = kinematics.load_arms(mechanism, np.zeros((n, 3)))
    moment = np.einsum("cab,nb->nca", _LEVI_CIVITA, arms)
    carries = (np.arange(n)[:, None] >= np.arange(n)[None, :]).astype(float)
    per_joint = np.einsum("nca,nj->ancj", moment, carries)
    return np.concatenate([per_joint, per_joint], axis=-1).reshape(3 * n, 3 * 2 * n)


def _lever_map(mechanism: Mechanism) -> np.ndarray:
    """(N, N · 2N): segment axes to the vectors from each joint to each contact point, zero beyond it."""
    n = mechanism.segment_count
    reach = np.zeros((n, n, n))
    for segment in range(n):
        for joint in range(segment + 1):
            reach[joint:segment, segment, joint] = mechanism.segment_length_m[joint:segment]
            reach[segment, segment, joint] = mechanism.contact_m[segment]
    return np.concatenate([reach, reach], axis=-1).reshape(n, n * 2 * n)
