"""Torques on the joints by weights, loads, springs and what touches the arm's end."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.plant.body import Body, TipSpring
from cablesense_gap.plant.geometry import Frames, frames, points_m

Array = NDArray[np.float64]


class Torques(NamedTuple):
    """Generalised forces of everything but cables and friction, B rows.

    Attributes:
        torque_nm: (B, 2J) on the joint angles.
        slope_nm_rad: (B, 2J, 2J) its derivative.
    """

    torque_nm: Array
    slope_nm_rad: Array


def torques(body: Body, angles_rad: Array, turning: Array, loads_n: Array) -> Torques:
    """Of weights, loads (B, N, 3) at the contact points, springs and surroundings.

    At joint angles (B, 2J), of which `turning` are the `geometry.turns`.
    """
    placed = frames(body, angles_rad, turning)
    joint = np.concatenate([body.mass_joint, body.contact_joint])
    at = np.concatenate([body.mass_at_m, body.contact_at_m])
    weight = body.mass_kg[:, None] * body.gravity_m_s2
    force = np.concatenate(
        [np.broadcast_to(weight, (len(angles_rad), *weight.shape)), loads_n], axis=1
    )
    torque, slope = _dead_forces(placed, joint, points_m(placed, joint, at), force)
    for spring in body.tip_springs:
        held = _tip_spring(body, placed, spring)
        torque, slope = torque + held[0], slope + held[1]
    sprung = _joint_springs(body, angles_rad)
    diagonal = np.arange(angles_rad.shape[1])
    slope[:, diagonal, diagonal] += sprung[1]
    return Torques(torque + sprung[0], slope)


def _dead_forces(
    placed: Frames, joint: NDArray[np.int64], point_m: Array, force_n: Array
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
    turning = np.stack(
        [
            moment[..., 1, 2] - moment[..., 2, 1],
            moment[..., 2, 0] - moment[..., 0, 2],
            moment[..., 0, 1] - moment[..., 1, 0],
        ],
        axis=-1,
    )
    axis = placed.axis
    torque = (axis * np.repeat(turning, 2, axis=1)).sum(-1)
    moments = np.repeat(moment, 2, axis=1)
    trace = (moments[..., 0, 0] + moments[..., 1, 1] + moments[..., 2, 2])[..., None]
    far = (moments @ axis[..., None])[..., 0] - trace * axis
    nearer = axis @ np.swapaxes(far, -1, -2)
    upper = np.tri(nearer.shape[-1]).T
    return torque, nearer * upper + np.swapaxes(nearer * (upper - np.eye(len(upper))), -1, -2)


def _tip_spring(body: Body, placed: Frames, spring: TipSpring) -> tuple[Array, Array]:
    last = np.array([body.joint_count - 1])
    tip = points_m(placed, last, body.tip_at_m[None])
    away = tip[:, 0] - np.array(spring.anchor_m)
    stiffness = np.broadcast_to(spring.stiffness_n_m * np.eye(3), (len(away), 3, 3))
    if spring.normal is not None:
        normal = np.array(spring.normal)
        touching = (away @ normal > 0.0).astype(float)
        stiffness = touching[:, None, None] * spring.stiffness_n_m * np.outer(normal, normal)
    force = -(stiffness @ away[..., None])[..., 0]
    torque, slope = _dead_forces(placed, last, tip, force[:, None])
    centres = np.repeat(placed.centre_m, 2, axis=1)
    lever = np.cross(placed.axis, tip - centres)
    return torque, slope - lever @ stiffness @ np.swapaxes(lever, -1, -2)


def _joint_springs(body: Body, angles_rad: Array) -> tuple[Array, Array]:
    linear, cubic = body.spring_nm_rad.ravel(), body.hardening_nm_rad3.ravel()
    height, per = body.cogging_nm.ravel(), body.cogging_per_turn
    torque = -(linear + cubic * angles_rad**2) * angles_rad - height * np.sin(per * angles_rad)
    slope = -linear - 3.0 * cubic * angles_rad**2 - per * height * np.cos(per * angles_rad)
    return torque, slope
