"""Closed-form kinematics of the chain and its cables, for NumPy and torch (array API standard).

Inside a segment a cable runs parallel to the axis, so only the spans between the two guide plates
around each joint change. A span depends on the two angles of its own joint alone: with holes
(y, z) before and (v, w) after the joint, plates at distance o, pitch a and yaw b,

    d(a, b)^2 = 2 o^2 + y^2 + z^2 + v^2 + w^2 + 2 g(a, b),    g = x1 P + w Q - y y1,
    x1 = o cos b - v sin b,   y1 = o sin b + v cos b,
    P = o cos a + z sin a,    Q = o sin a - z cos a,

from which the derivatives below follow (dP/da = -Q, dQ/da = P, dx1/db = -y1, dy1/db = x1).
"""

from __future__ import annotations

from typing import Any, NamedTuple

from array_api_compat import array_namespace

from cablesense_sim.mechanism import Mechanism

_TOUCHING_M = 1e-9
"""Where the two plates of a joint touch at a hole the span is zero and has no direction."""


class Spans(NamedTuple):
    """Cable spans across the joints, zero where a cable does not pass. All (..., M, N)."""

    length_m: Any
    by_pitch: Any
    by_yaw: Any
    by_pitch_pitch: Any
    by_pitch_yaw: Any
    by_yaw_yaw: Any

    @property
    def second_derivatives(self) -> tuple[tuple[int, int, Any], ...]:
        """Each with its row and column (0 pitch, 1 yaw) among the angles of the span's joint."""
        pitch, mixed, yaw = self.by_pitch_pitch, self.by_pitch_yaw, self.by_yaw_yaw
        return (0, 0, pitch), (0, 1, mixed), (1, 0, mixed), (1, 1, yaw)


class Chain(NamedTuple):
    """The chain's pose in the base frame.

    Attributes:
        rotation: (..., N, 3, 3) segment frame to base.
        joint_m: (..., N, 3) joint centres.
        joint_axis: (..., 2N, 3) unit axes of the joint angles.
    """

    rotation: Any
    joint_m: Any
    joint_axis: Any


def spans(mechanism: Mechanism, joint_angles_rad: Any) -> Spans:
    """Spans and their first and second derivatives at joint angles (..., 2N)."""
    xp = array_namespace(joint_angles_rad)
    q = joint_angles_rad
    pitch, yaw = q[..., None, 0::2], q[..., None, 1::2]
    as_like = _converter(xp, q)
    (y, z), (v, w) = ((as_like(a), as_like(b)) for a, b in mechanism.plate_holes_m)
    passes = as_like(mechanism.passes_joint)
    o = mechanism.plate_offset_m
    cos_a, sin_a, cos_b, sin_b = xp.cos(pitch), xp.sin(pitch), xp.cos(yaw), xp.sin(yaw)
    x1, y1 = o * cos_b - v * sin_b, o * sin_b + v * cos_b
    p, q_ = o * cos_a + z * sin_a, o * sin_a - z * cos_a
    x1p, wq, yy1 = x1 * p, w * q_, y * y1
    squared = 2.0 * o * o + (y * y + z * z + v * v + w * w) + 2.0 * (x1p + wq - yy1)
    length = xp.sqrt(xp.clip(squared, _TOUCHING_M**2, None))
    scale = passes / length
    by_a = (w * p - x1 * q_) * scale
    by_b = (-y1 * p - y * x1) * scale
    return Spans(
        length_m=length * passes,
        by_pitch=by_a,
        by_yaw=by_b,
        by_pitch_pitch=(-x1p - wq) * scale - by_a * by_a * scale,
        by_pitch_yaw=(y1 * q_) * scale - by_a * by_b * scale,
        by_yaw_yaw=(yy1 - x1p) * scale - by_b * by_b * scale,
    )


def cable_lengths_m(mechanism: Mechanism, joint_angles_rad: Any) -> Any:
    """Cable lengths (..., M) from actuator to anchor at joint angles (..., 2N)."""
    xp = array_namespace(joint_angles_rad)
    joints = mechanism.cable_segment
    straight_parts = mechanism.straight_length_m - 2.0 * mechanism.plate_offset_m * joints
    constant = _converter(xp, joint_angles_rad)(straight_parts)
    return constant + xp.sum(spans(mechanism, joint_angles_rad).length_m, axis=-1)


def cable_jacobian_m(mechanism: Mechanism, joint_angles_rad: Any) -> Any:
    """Derivative (..., M, 2N) of the cable lengths by the joint angles, m/rad."""
    return interleave(spans(mechanism, joint_angles_rad))


def bend_rad(joint_angles_rad: Any) -> Any:
    """Angle (..., N) between the axes before and after each joint, at joint angles (..., 2N)."""
    xp = array_namespace(joint_angles_rad)
    q = joint_angles_rad
    cosine = xp.cos(q[..., 0::2]) * xp.cos(q[..., 1::2])
    return xp.acos(xp.clip(cosine, -1.0, 1.0))


def interleave(span: Spans) -> Any:
    """The Jacobian (..., M, 2N) in the order of the joint angles: pitch, yaw, and so on."""
    xp = array_namespace(span.by_pitch)
    both = xp.stack([span.by_pitch, span.by_yaw], axis=-1)
    return xp.reshape(both, (*both.shape[:-2], 2 * both.shape[-2]))


def chain(mechanism: Mechanism, joint_angles_rad: Any) -> Chain:
    """Pose of every segment at joint angles (..., 2N): each joint turns by `Ry(pitch) Rz(yaw)`."""
    xp = array_namespace(joint_angles_rad)
    q = joint_angles_rad
    cos, sin = xp.cos(q), xp.sin(q)
    zero, one = xp.zeros_like(cos[..., 0]), xp.ones_like(cos[..., 0])
    ex = xp.stack([one, zero, zero], axis=-1)
    ey = xp.stack([zero, one, zero], axis=-1)
    ez = xp.stack([zero, zero, one], axis=-1)
    joint = mechanism.plate_offset_m * ex
    rotations, joints, axes = [], [], []
    for n in range(mechanism.segment_count):
        cos_a, sin_a = cos[..., 2 * n, None], sin[..., 2 * n, None]
        cos_b, sin_b = cos[..., 2 * n + 1, None], sin[..., 2 * n + 1, None]
        joints.append(joint)
        axes.append(ey)
        pitched_x, ez = cos_a * ex - sin_a * ez, sin_a * ex + cos_a * ez
        axes.append(ez)
        ex, ey = cos_b * pitched_x + sin_b * ey, cos_b * ey - sin_b * pitched_x
        rotations.append(xp.stack([ex, ey, ez], axis=-1))
        joint = joint + float(mechanism.segment_length_m[n]) * ex
    return Chain(
        rotation=xp.stack(rotations, axis=-3),
        joint_m=xp.stack(joints, axis=-2),
        joint_axis=xp.stack(axes, axis=-2),
    )


def segment_rotations(mechanism: Mechanism, joint_angles_rad: Any) -> Any:
    """Rotation (..., N, 3, 3) from each segment's frame to the base frame."""
    return chain(mechanism, joint_angles_rad).rotation


def joint_positions_m(mechanism: Mechanism, joint_angles_rad: Any) -> Any:
    """Joint centres (..., N, 3), base frame."""
    return chain(mechanism, joint_angles_rad).joint_m


def contact_points_m(mechanism: Mechanism, joint_angles_rad: Any) -> Any:
    """Contact points (..., N, 3) on the segments' axes, base frame."""
    xp = array_namespace(joint_angles_rad)
    pose = chain(mechanism, joint_angles_rad)
    reach = _converter(xp, joint_angles_rad)(mechanism.contact_m)
    return pose.joint_m + reach[:, None] * pose.rotation[..., 0]


def load_arms(mechanism: Mechanism, forces_n: Any) -> Any:
    """Generalised forces (..., N, 3) on the segments' axis vectors, N·m.

    Weights and contact forces act on the axes, so their potential is `-sum_n A_n · x_n` with x_n
    the unit axis of segment n; this gives A_n for contact forces (..., N, 3) in base axes.
    """
    xp = array_namespace(forces_n)
    as_like = _converter(xp, forces_n)
    mass, length = as_like(mechanism.mass_kg)[..., None], as_like(mechanism.segment_length_m)
    weight = mass * as_like(mechanism.gravity_m_s2)[..., None, :]
    reach, centre = as_like(mechanism.contact_m), as_like(mechanism.centre_of_mass_m)
    total = weight + forces_n
    beyond = xp.flip(xp.cumulative_sum(xp.flip(total, axis=-2), axis=-2), axis=-2) - total
    return centre[..., None] * weight + reach[..., None] * forces_n + length[..., None] * beyond


def axis_torques_n_m(pose: Chain, load_arms_n_m: Any) -> Any:
    """Joint torques (..., 2N) of generalised forces (..., N, 3) on the segments' axis vectors."""
    xp = array_namespace(load_arms_n_m)
    moment = xp.linalg.cross(pose.rotation[..., 0], load_arms_n_m)
    distal = xp.flip(xp.cumulative_sum(xp.flip(moment, axis=-2), axis=-2), axis=-2)
    per_joint = xp.repeat(distal, 2, axis=-2)
    return xp.sum(pose.joint_axis * per_joint, axis=-1)


def contact_jacobians_m(mechanism: Mechanism, joint_angles_rad: Any) -> Any:
    """Derivative (..., N, 3, 2N) of the contact points by the joint angles, m/rad."""
    xp = array_namespace(joint_angles_rad)
    pose = chain(mechanism, joint_angles_rad)
    reach = _converter(xp, joint_angles_rad)(mechanism.contact_m)
    points = pose.joint_m + reach[:, None] * pose.rotation[..., 0]
    arm = points[..., :, None, :] - xp.repeat(pose.joint_m, 2, axis=-2)[..., None, :, :]
    axis = xp.broadcast_to(pose.joint_axis[..., None, :, :], arm.shape)
    columns = xp.linalg.cross(axis, arm)
    n, k = mechanism.segment_count, mechanism.joint_count
    moves = _converter(xp, joint_angles_rad)(
        [[1.0 if j // 2 <= s else 0.0 for j in range(k)] for s in range(n)]
    )
    return xp.moveaxis(columns * moves[..., None], -1, -2)


def _converter(xp: Any, like: Any) -> Any:
    """Turns constants into arrays of the caller's namespace, type and device."""

    def convert(values: Any) -> Any:
        return xp.asarray(values, dtype=like.dtype, device=getattr(like, "device", None))

    return convert
