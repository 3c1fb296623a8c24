"""Closed-form kinematics of the chain and its cables.

Inside a segment a cable runs parallel to the axis, so only the spans between the two guide plates
around each joint change. A span depends only on the two angles of its joint: with holes (y, z)
before and (v, w) after the joint, plates at distance o, pitch a and yaw b,

    d(a, b)^2 = 2 o^2 + y^2 + z^2 + v^2 + w^2 + 2 g(a, b),    g = x1 P + w Q - y y1,
    x1 = o cos b - v sin b,   y1 = o sin b + v cos b,
    P = o cos a + z sin a,    Q = o sin a - z cos a,

from which the derivatives follow (dP/da = -Q, dQ/da = P, dx1/db = -y1, dy1/db = x1).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_sim.mechanism import Mechanism

_TOUCHING_M = 1e-9
"""If the two plates of a joint touch at a hole, the span is zero and has no direction."""


class CableSpans(NamedTuple):
    """Cable spans across the joints, zero where a cable does not pass. All (..., M, N)."""

    length_m: Array
    by_pitch: Array
    by_yaw: Array


class SegmentChain(NamedTuple):
    """The chain's pose in the base frame."""

    rotation: Array  # (..., N, 3, 3) segment frame to base
    joint_m: Array  # (..., N, 3) joint centres
    joint_axis: Array  # (..., 2N, 3) unit axes of the joint angles


def spans(mechanism: Mechanism, joint_angles_rad: Array) -> CableSpans:
    """Spans and their derivatives at joint angles (..., 2N)."""
    q = joint_angles_rad
    pitch = q[..., None, 0::2]
    yaw = q[..., None, 1::2]
    (y, z), (v, w) = mechanism.plate_holes_m
    passes = mechanism.passes_joint
    o = mechanism.plate_offset_m
    cos_a = np.cos(pitch)
    sin_a = np.sin(pitch)
    cos_b = np.cos(yaw)
    sin_b = np.sin(yaw)
    x1 = o * cos_b - v * sin_b
    y1 = o * sin_b + v * cos_b
    p = o * cos_a + z * sin_a
    q_ = o * sin_a - z * cos_a
    squared = 2.0 * o * o + (y * y + z * z + v * v + w * w)
    squared = squared + 2.0 * (x1 * p + w * q_ - y * y1)
    length = np.sqrt(np.maximum(squared, _TOUCHING_M**2))
    scale = passes / length
    return CableSpans(
        length_m=length * passes,
        by_pitch=(w * p - x1 * q_) * scale,
        by_yaw=(-y1 * p - y * x1) * scale,
    )


def cable_lengths_m(mechanism: Mechanism, joint_angles_rad: Array) -> Array:
    """Cable lengths (..., M) from actuator to anchor at joint angles (..., 2N)."""
    joints = mechanism.cable_segment
    straight_parts = mechanism.straight_length_m - 2.0 * mechanism.plate_offset_m * joints
    return np.asarray(straight_parts + spans(mechanism, joint_angles_rad).length_m.sum(-1))


def cable_jacobian_m(mechanism: Mechanism, joint_angles_rad: Array) -> Array:
    """Derivative (..., M, 2N) of the cable lengths by the joint angles, m/rad."""
    span = spans(mechanism, joint_angles_rad)
    by_angle = np.stack([span.by_pitch, span.by_yaw], axis=-1)
    return np.reshape(by_angle, (*by_angle.shape[:-2], 2 * by_angle.shape[-2]))


def bend_rad(joint_angles_rad: Array) -> Array:
    """Angle (..., N) between the axes before and after each joint, at joint angles (..., 2N)."""
    q = joint_angles_rad
    cosine = np.cos(q[..., 0::2]) * np.cos(q[..., 1::2])
    return np.arccos(np.clip(cosine, -1.0, 1.0))


def chain(mechanism: Mechanism, joint_angles_rad: Array) -> SegmentChain:
    """Pose of every segment at joint angles (..., 2N): each joint turns by `Ry(pitch) Rz(yaw)`."""
    q = joint_angles_rad
    cos = np.cos(q)
    sin = np.sin(q)
    zero = np.zeros_like(cos[..., 0])
    one = np.ones_like(cos[..., 0])
    ex = np.stack([one, zero, zero], axis=-1)
    ey = np.stack([zero, one, zero], axis=-1)
    ez = np.stack([zero, zero, one], axis=-1)
    joint = mechanism.plate_offset_m * ex
    rotations = []
    joints = []
    axes = []
    for n in range(mechanism.segment_count):
        cos_a = cos[..., 2 * n, None]
        sin_a = sin[..., 2 * n, None]
        cos_b = cos[..., 2 * n + 1, None]
        sin_b = sin[..., 2 * n + 1, None]
        joints.append(joint)
        axes.append(ey)
        pitched_x = cos_a * ex - sin_a * ez
        ez = sin_a * ex + cos_a * ez
        axes.append(ez)
        ex = cos_b * pitched_x + sin_b * ey
        ey = cos_b * ey - sin_b * pitched_x
        rotations.append(np.stack([ex, ey, ez], axis=-1))
        joint = joint + float(mechanism.segment_length_m[n]) * ex
    return SegmentChain(
        rotation=np.stack(rotations, axis=-3),
        joint_m=np.stack(joints, axis=-2),
        joint_axis=np.stack(axes, axis=-2),
    )


def segment_rotations(mechanism: Mechanism, joint_angles_rad: Array) -> Array:
    """Rotation (..., N, 3, 3) from each segment's frame to the base frame."""
    return chain(mechanism, joint_angles_rad).rotation


def joint_positions_m(mechanism: Mechanism, joint_angles_rad: Array) -> Array:
    """Joint centres (..., N, 3), base frame."""
    return chain(mechanism, joint_angles_rad).joint_m


def contact_points_m(mechanism: Mechanism, joint_angles_rad: Array) -> Array:
    """Contact points (..., N, 3) on the segments' axes, base frame."""
    pose = chain(mechanism, joint_angles_rad)
    contact_m = mechanism.contact_m
    return pose.joint_m + contact_m[:, None] * pose.rotation[..., 0]


def load_arms(mechanism: Mechanism, forces_n: Array) -> Array:
    """Generalised forces (..., N, 3) on the segments' axis vectors, N·m.

    Weights and contact forces act on the axes, so their potential is `-sum_n A_n · x_n` with x_n
    the unit axis of segment n; this gives A_n for contact forces (..., N, 3) in base axes.
    """
    contact_m = mechanism.contact_m
    centre = mechanism.centre_of_mass_m
    length = mechanism.segment_length_m
    weight = mechanism.mass_kg[..., None] * mechanism.gravity_m_s2[..., None, :]
    total = weight + forces_n
    beyond = np.cumsum(total[..., ::-1, :], axis=-2)[..., ::-1, :] - total
    return (
        centre[..., None] * weight + contact_m[..., None] * forces_n + length[..., None] * beyond
    )


def contact_jacobians_m(mechanism: Mechanism, joint_angles_rad: Array) -> Array:
    """Derivative (..., N, 3, 2N) of the contact points by the joint angles, m/rad."""
    at_joint, slope = contact_torques(mechanism, joint_angles_rad, np.eye(3))
    return np.asarray(at_joint + mechanism.contact_m[..., None, None] * slope)


def contact_torques(
    mechanism: Mechanism, joint_angles_rad: Array, axes: Array
) -> tuple[Array, Array]:
    """Joint torques (..., N, 3, 2N) of unit forces at joint centres, and their slope by the place.

    Forces are along the columns of `axes` (..., 3, 3), or (..., N, 3, 3) for each segment its own.
    """
    pose = chain(mechanism, joint_angles_rad)
    joint = np.arange(mechanism.joint_count) // 2
    moves = (joint <= np.arange(mechanism.segment_count)[:, None])[..., None]
    turning = pose.joint_axis[..., None, :, :]
    arms_m = pose.joint_m[..., :, None, :] - pose.joint_m[..., None, joint, :]
    at_joint, slope = (
        np.swapaxes(np.cross(turning, arm) * moves @ axes, -1, -2)
        for arm in (arms_m, pose.rotation[..., :, None, :, 0])
    )
    return at_joint, slope
