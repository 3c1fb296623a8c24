"""Geometry and loads of a body at given joint angles.

Where its holes and points are, how its cables lengthen, and the torques of weights, loads, springs
and what touches the arm's end.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_plants.arm.body import Body, CableContact, TipSpring

_LEFT, _RIGHT = [0, 0, 1], [0, 1, 1]
_PITCH_ORDER = np.array([0, 1, 0, 2, 1, 0])
_YAW_ORDER = np.array([0, 0, 1, 0, 1, 2])


class SpanGeometry(NamedTuple):
    """The pieces of cable across the joints, B rows.

    Attributes:
        length_m: (B, J, M) from plate to plate, with what contacts of cables add; 0 where a cable
            ends before.
        slope_m_rad: (B, J, 2, M) by pitch and yaw of that joint.
        curve_m_rad2: (B, J, 3, M) second derivatives: pitch twice, both, yaw twice.
        bend_rad: (B, J, 2, M) by which the cable turns at the guides before and after the joint; 0
            where it is anchored or has ended.
    """

    length_m: Array
    slope_m_rad: Array
    curve_m_rad2: Array
    bend_rad: Array


class JointFrames(NamedTuple):
    """The joints in the base frame, B rows.

    Attributes:
        rotation: (B, J, 3, 3) of the frame that each joint turns.
        centre_m: (B, J, 3) of each joint.
        axis: (B, 2J, 3) pitch and yaw axes, unit.
    """

    rotation: Array
    centre_m: Array
    axis: Array


def spans(body: Body, angles_rad: Array, turning: Array, with_bends: bool = False) -> SpanGeometry:
    """Cable spans at joint angles (B, 2J), of which `turning` are the `turns`."""
    turned = turning @ np.swapaxes(body.after_m, -1, -2)
    v = turned[0] - np.swapaxes(body.before_m, -1, -2)
    first, second = turned[1:3], turned[3:6]
    length = np.sqrt((v * v).sum(-2))
    slope = (first * v).sum(-2) / length
    pairs = (first[_LEFT] * first[_RIGHT] + second * v).sum(-2)
    curve = (pairs - slope[_LEFT] * slope[_RIGHT]) / length
    bends = _bends(body, turning[0], v / length[..., None, :]) if with_bends else np.zeros(0)
    slope, curve = (np.moveaxis(values * body.passes, 0, -2) for values in (slope, curve))
    result = SpanGeometry(length * body.passes, slope, curve, bends)
    for contact in body.cable_contacts:
        result = _pushed_aside(result, contact, angles_rad)
    return result


def cable_lengths_m(body: Body, angles_rad: Array) -> Array:
    """(B, M) lengths across all joints at angles (B, 2J); what lies in segments is constant."""
    return spans(body, angles_rad, turns(body, angles_rad)).length_m.sum(-2)


def frames(body: Body, angles_rad: Array, turning: Array) -> JointFrames:
    """Frames of the joints in base axes at angles (B, 2J), of which `turning` are the `turns`."""
    rows, joints = angles_rad.shape[0], body.joint_count
    sine, cosine = np.sin(angles_rad[:, ::2]), np.cos(angles_rad[:, ::2])
    rotation = np.empty((rows, joints, 3, 3))
    centre = np.empty((rows, joints, 3))
    axis = np.empty((rows, 2 * joints, 3))
    before: Array = np.tile(np.eye(3), (rows, 1, 1))
    at: Array = np.zeros((rows, 3))
    for j in range(joints):
        at = at + body.spacing_m[j] * before[:, :, 0]
        centre[:, j] = at
        skewed = before @ body.skew[j]
        axis[:, 2 * j] = skewed[:, :, 1]
        forward = sine[:, j, None] * skewed[:, :, 0]
        axis[:, 2 * j + 1] = forward + cosine[:, j, None] * skewed[:, :, 2]
        before = before @ turning[0, :, j]
        rotation[:, j] = before
    return JointFrames(rotation, centre, axis)


def points_m(placed: JointFrames, joint: NDArray[np.int64], at_m: Array) -> Array:
    """(B, P, 3) base-frame places of points (P, 3) of the frames that joints (P,) turn."""
    return placed.centre_m[:, joint] + (placed.rotation[:, joint] @ at_m[..., None])[..., 0]


def turns(body: Body, angles_rad: Array) -> Array:
    """(6, B, J, 3, 3) rotations over joints at angles (B, 2J), derivatives p, y, pp, py, yy."""
    by_pitch, by_yaw = _about(angles_rad[:, ::2], 2, 0), _about(angles_rad[:, 1::2], 0, 1)
    level = np.swapaxes(body.skew, -1, -2)
    return body.skew @ by_pitch[_PITCH_ORDER] @ by_yaw[_YAW_ORDER] @ level


def _about(angle: Array, first: int, second: int) -> Array:
    """(3, ..., 3, 3) turns from axis `first` to axis `second`, first and second derivatives."""
    result = np.zeros((3, *angle.shape, 3, 3))
    sine, cosine = np.sin(angle), np.cos(angle)
    for order, (along, across) in enumerate(((cosine, sine), (-sine, cosine), (-cosine, -sine))):
        result[order, ..., first, first] = result[order, ..., second, second] = along
        result[order, ..., second, first] = across
        result[order, ..., first, second] = -across
    still = 3 - first - second
    result[0, ..., still, still] = 1.0
    return result


def _bends(body: Body, turning: Array, direction: Array) -> Array:
    """(B, J, 2, M) by the straight pieces inside the segments before and after each joint."""
    pieces = body.before_m[1:] - body.after_m[:-1]
    pieces[..., 0] += body.spacing_m[1:, None]
    pieces /= np.linalg.norm(pieces, axis=-1, keepdims=True)
    outside = np.broadcast_to([1.0, 0.0, 0.0], (1, *pieces.shape[1:]))
    back = np.swapaxes(np.concatenate([outside, pieces]), -1, -2)
    ahead = np.swapaxes(np.concatenate([pieces, outside]), -1, -2)
    own = np.swapaxes(turning, -1, -2) @ direction
    away = np.stack([direction - back, own - ahead], axis=-3)
    chords = np.sqrt((away * away).sum(axis=-2))
    anchored = np.append(body.passes[1:], np.zeros_like(body.passes[:1]), axis=0)
    guided = np.stack([body.passes, anchored], axis=1)
    return 2.0 * np.arcsin(np.minimum(0.5 * chords, 1.0)) * guided


def _pushed_aside(free: SpanGeometry, contact: CableContact, angles_rad: Array) -> SpanGeometry:
    j, cables = contact.joint, list(contact.cables)
    p, y = contact.toward
    beyond = p * angles_rad[:, 2 * j] + y * angles_rad[:, 2 * j + 1] - contact.from_rad
    beyond = np.maximum(beyond, 0.0)[:, None]
    touching = (beyond > 0.0) * 2.0 * contact.depth_m_rad2
    length, slope, curve = free.length_m, free.slope_m_rad.copy(), free.curve_m_rad2.copy()
    length[:, j, cables] += contact.depth_m_rad2 * beyond**2
    for i, share in enumerate((p, y)):
        slope[:, j, i, cables] += touching * beyond * share
    for i, share in enumerate((p * p, p * y, y * y)):
        curve[:, j, i, cables] += touching * share
    return SpanGeometry(length, slope, curve, free.bend_rad)


def torques(body: Body, angles_rad: Array, turning: Array, loads_n: Array) -> tuple[Array, Array]:
    """Generalised forces of all but cables and friction: N·m (B, 2J), and slopes (B, 2J, 2J).

    Those of weights, loads (B, N, 3) at the contact points, springs and surroundings, at joint
    angles (B, 2J), of which `turning` are the `turns`.
    """
    placed = frames(body, angles_rad, turning)
    joint = np.concatenate([body.mass_joint, body.contact_joint])
    at = np.concatenate([body.mass_at_m, body.contact_at_m])
    weight = np.tile(body.mass_kg[:, None] * body.gravity_m_s2, (len(angles_rad), 1, 1))
    force = np.concatenate([weight, loads_n], axis=1)
    torque, slope = _constant_forces(placed, joint, points_m(placed, joint, at), force)
    for spring in body.tip_springs:
        pulled = _tip_spring(body, placed, spring)
        torque, slope = torque + pulled[0], slope + pulled[1]
    linear, cubic = body.spring_nm_rad.ravel(), body.hardening_nm_rad3.ravel()
    height, per = body.cogging_nm.ravel(), body.cogging_per_turn
    back = -(linear + cubic * angles_rad**2) * angles_rad - height * np.sin(per * angles_rad)
    stiffness = -linear - 3.0 * cubic * angles_rad**2 - per * height * np.cos(per * angles_rad)
    diagonal = np.arange(angles_rad.shape[1])
    slope[:, diagonal, diagonal] += stiffness
    return torque + back, slope


def _constant_forces(
    placed: JointFrames, joint: NDArray[np.int64], point_m: Array, force_n: Array
) -> tuple[Array, Array]:
    """By forces (B, P, 3) that keep their direction: J(q)^T F and its derivative.

    With W the sum of (p - o) F^T beyond a joint, the derivative by two angles, the axis `a` not
    beyond `b`, is a^T W b - trace(W) a^T b.
    """
    joints = placed.centre_m.shape[1]
    beyond = (joint[:, None] >= np.arange(joints)).astype(float)
    arm = point_m[:, :, None, :] - placed.centre_m[:, None]
    pushed = force_n[:, :, None, :] * beyond[..., None]
    moment = np.swapaxes(np.moveaxis(arm, 2, 1), -1, -2) @ np.moveaxis(pushed, 2, 1)
    first, second = [1, 2, 0], [2, 0, 1]
    turning = moment[..., first, second] - moment[..., second, first]
    axis = placed.axis
    torque = (axis * np.repeat(turning, 2, axis=1)).sum(-1)
    moments = np.repeat(moment, 2, axis=1)
    trace = (moments[..., 0, 0] + moments[..., 1, 1] + moments[..., 2, 2])[..., None]
    far = (moments @ axis[..., None])[..., 0] - trace * axis
    nearer = axis @ np.swapaxes(far, -1, -2)
    upper = np.tri(nearer.shape[-1]).T
    return torque, nearer * upper + np.swapaxes(nearer * (upper - np.eye(len(upper))), -1, -2)


def _tip_spring(body: Body, placed: JointFrames, spring: TipSpring) -> tuple[Array, Array]:
    last = np.array([body.joint_count - 1])
    tip = points_m(placed, last, body.tip_at_m[None])
    away = tip[:, 0] - np.array(spring.anchor_m)
    stiffness = np.broadcast_to(spring.stiffness_n_m * np.eye(3), (len(away), 3, 3))
    if spring.normal is not None:
        normal = np.array(spring.normal)
        touching = (away @ normal > 0.0).astype(float)
        stiffness = touching[:, None, None] * spring.stiffness_n_m * np.outer(normal, normal)
    force = -(stiffness @ away[..., None])[..., 0]
    torque, slope = _constant_forces(placed, last, tip, force[:, None])
    centres = np.repeat(placed.centre_m, 2, axis=1)
    lever = np.cross(placed.axis, tip - centres)
    return torque, slope - lever @ stiffness @ np.swapaxes(lever, -1, -2)
