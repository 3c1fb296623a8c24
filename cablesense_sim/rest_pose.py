"""An arm in one pose, compiled: what its cables span, and the balance of its joint torques.

The same quantities as of `cablesense_sim.kinematics`, for few arms that go from rest to rest,
where NumPy's calls would cost more than the arithmetic.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_sim.compiled import compiled
from cablesense_sim.mechanism import Mechanism

_TOUCHING_M = 1e-9


class Plates(NamedTuple):
    """Guide plates of P arms, which hardly differ.

    Attributes:
        offset_m: of the plates before and after each joint centre.
        holes_m: (P, M, N, 4) y and z before a joint, and behind it.
        passes: (M, N) 1 where a cable passes a joint.
    """

    offset_m: float
    holes_m: Array
    passes: Array


class Springs(NamedTuple):
    """Plates of one arm, stiffness of its M cables, and that of its 2N joint axes."""

    plates: Plates
    cable_n_m: Array
    joint_n_m_rad: Array


class Pose(NamedTuple):
    """P arms in a pose.

    Attributes:
        span_m: (P, M, N) cable between the plates of a joint, zero where none passes.
        by_turn_m: (P, M, N, 2) their derivative by the two angles of the joint.
        by_turns_m: (P, M, N, 3) the second, by pitch, both and yaw.
        bend_rad: (P, M, N, 2) by how much a cable turns at the guide before and behind a joint.
        axis: (P, N, 3) of each segment, unit vector.
        joint_axis: (P, 2N, 3) of each joint angle, unit vector.
    """

    span_m: Array
    by_turn_m: Array
    by_turns_m: Array
    bend_rad: Array
    axis: Array
    joint_axis: Array


class Balance(NamedTuple):
    """Joint torques of P arms in a pose.

    Attributes:
        torque_n_m: (P, 2N) left unbalanced.
        slope_n_m: (P, 2N, 2N) its derivative by the joint angles.
    """

    torque_n_m: Array
    slope_n_m: Array


def plates_of(mechanism: Mechanism, count: int) -> Plates:
    """The plates of `count` arms, stacked in one mechanism."""
    passes = mechanism.passes_joint.astype(float)
    before, after = mechanism.plate_holes_m
    holes = [np.broadcast_to(each, (count, *passes.shape)) for each in (*before, *after)]
    return Plates(mechanism.plate_offset_m, np.stack(holes, axis=-1), passes)


def springs_of(mechanism: Mechanism) -> Springs:
    """The plates and the stiffness of one arm."""
    joint_n_m_rad = np.repeat(mechanism.joint_stiffness_n_m_rad, 2).astype(float)
    return Springs(
        plates_of(mechanism, 1), np.array(mechanism.stiffness_n_m, float), joint_n_m_rad
    )


@compiled
def posed(plates: Plates, angles_rad: Array) -> Pose:
    """The arms at joint angles (P, 2N); formulas as in `cablesense_sim.kinematics`."""
    arms, cables, joints = plates.holes_m.shape[:3]
    pose = Pose(
        np.zeros((arms, cables, joints)),
        np.zeros((arms, cables, joints, 2)),
        np.zeros((arms, cables, joints, 3)),
        np.zeros((arms, cables, joints, 2)),
        np.empty((arms, joints, 3)),
        np.empty((arms, 2 * joints, 3)),
    )
    for p in range(arms):
        cos, sin = np.cos(angles_rad[p]), np.sin(angles_rad[p])
        turn_axes(cos, sin, pose.axis[p], pose.joint_axis[p])
        for m in range(cables):
            for n in range(joints):
                if plates.passes[m, n] == 0.0:
                    continue
                holes = plates.holes_m[p, m, n]
                span, before, after = span_m(
                    plates.offset_m,
                    holes,
                    cos[2 * n : 2 * n + 2],
                    sin[2 * n : 2 * n + 2],
                    pose.by_turn_m[p, m, n],
                    pose.by_turns_m[p, m, n],
                )
                pose.span_m[p, m, n] = span
                bend = pose.bend_rad[p, m, n]
                bend[0] = np.arccos(min(max(before / span, -1.0), 1.0))
                bend[1] = np.arccos(min(max(after / span, -1.0), 1.0))
    return pose


@compiled
def span_m(
    offset_m: float, holes_m: Array, cos: Array, sin: Array, by_turn_m: Array, by_turns_m: Array
) -> tuple[float, float, float]:
    """A cable's span across a joint at angles with `cos` and `sin` (2,), and parts of it.

    These are its components along the axes before and behind the joint. Writes its derivatives,
    (2,) and (3,) as of `Pose`.
    """
    o, (y, z, v, w) = offset_m, holes_m
    cos_a, cos_b = cos
    sin_a, sin_b = sin
    x1, y1 = o * cos_b - v * sin_b, o * sin_b + v * cos_b
    along, across = o * cos_a + z * sin_a, o * sin_a - z * cos_a
    squared = 2.0 * o * o + (y * y + z * z + v * v + w * w)
    squared += 2.0 * (x1 * along + w * across - y * y1)
    span = np.sqrt(max(squared, _TOUCHING_M**2))
    by_a, by_b = (w * along - x1 * across) / span, -(y1 * along + y * x1) / span
    by_turn_m[0], by_turn_m[1] = by_a, by_b
    by_turns_m[0] = -(x1 * along + w * across + by_a * by_a) / span
    by_turns_m[1] = (y1 * across - by_a * by_b) / span
    by_turns_m[2] = (y * y1 - x1 * along - by_b * by_b) / span
    return span, o + x1 * cos_a + w * sin_a, o + along * cos_b - y * sin_b


@compiled
def turn_axes(cos: Array, sin: Array, axis: Array, joint_axis: Array) -> None:
    """Writes the axes (N, 3) and (2N, 3) of a `Pose` for angles with `cos` and `sin` (2N,)."""
    ex, ey, ez = np.eye(3)
    for n in range(len(axis)):
        for i in range(3):
            joint_axis[2 * n, i] = ey[i]
            pitched = cos[2 * n] * ex[i] - sin[2 * n] * ez[i]
            ez[i] = sin[2 * n] * ex[i] + cos[2 * n] * ez[i]
            joint_axis[2 * n + 1, i] = ez[i]
            ex[i] = cos[2 * n + 1] * pitched + sin[2 * n + 1] * ey[i]
            ey[i] = cos[2 * n + 1] * ey[i] - sin[2 * n + 1] * pitched
            axis[n, i] = ex[i]


@compiled
def take_load_torque(axis: Array, joint_axis: Array, arms_n_m: Array, torque_n_m: Array) -> None:
    """Takes the joint torques of loads (N, 3) off those (2N,)."""
    x = y = z = 0.0
    for n in range(len(axis) - 1, -1, -1):
        (a, b, c), (f, g, h) = axis[n], arms_n_m[n]
        x, y, z = x + b * h - c * g, y + c * f - a * h, z + a * g - b * f
        for k in (2 * n, 2 * n + 1):
            torque_n_m[k] -= joint_axis[k, 0] * x + joint_axis[k, 1] * y + joint_axis[k, 2] * z


@compiled
def balanced(
    pose: Pose,
    along_n: Array,
    by_span_n_m: Array,
    arms_n_m: Array,
    resisted_n_m: Array,
    resisted_slope_n_m: Array,
) -> Balance:
    """Torques of tensions (P, M, N) in the spans, with their derivative (P, M, N, N) by these.

    Loads are generalised forces (P, N, 3) on the segments' axes; what joints resist by themselves
    (P, 2N) has a slope by each joint's own angle.
    """
    arms, cables, joints = along_n.shape
    torque = resisted_n_m.copy()
    slope = np.zeros((arms, 2 * joints, 2 * joints))
    for p in range(arms):
        take_load_torque(pose.axis[p], pose.joint_axis[p], arms_n_m[p], torque[p])
        own = slope[p]
        for k in range(2 * joints):
            own[k, k] = resisted_slope_n_m[p, k]
        for m in range(cables):
            for n in range(joints):
                pitch, both, yaw = along_n[p, m, n] * pose.by_turns_m[p, m, n]
                own[2 * n, 2 * n] += pitch
                own[2 * n, 2 * n + 1] += both
                own[2 * n + 1, 2 * n] += both
                own[2 * n + 1, 2 * n + 1] += yaw
            for i in range(2 * joints):
                lever = pose.by_turn_m[p, m, i // 2, i % 2]
                torque[p, i] += along_n[p, m, i // 2] * lever
                for j in range(2 * joints):
                    stiffness = by_span_n_m[p, m, i // 2, j // 2]
                    own[i, j] += lever * stiffness * pose.by_turn_m[p, m, j // 2, j % 2]
        take_load_slope(pose.axis[p], pose.joint_axis[p], arms_n_m[p], own)
    return Balance(torque, slope)


@compiled
def take_load_slope(axis: Array, joint_axis: Array, arms_n_m: Array, slope: Array) -> None:
    """Takes the second derivative of `sum_n A_n · x_n` off a slope (2N, 2N).

    For a joint axis k before l it is A_n · (w_k x (w_l x x_n)), summed over the segments beyond.
    """
    outer, along = np.zeros((3, 3)), 0.0
    turned = np.zeros(3)
    for n in range(len(axis) - 1, -1, -1):
        for i in range(3):
            along += axis[n, i] * arms_n_m[n, i]
            for j in range(3):
                outer[i, j] += axis[n, i] * arms_n_m[n, j]
        for later in (2 * n, 2 * n + 1):
            for i in range(3):
                turned[i] = -along * joint_axis[later, i]
                for j in range(3):
                    turned[i] += outer[i, j] * joint_axis[later, j]
            for k in range(later + 1):
                found = 0.0
                for i in range(3):
                    found += joint_axis[k, i] * turned[i]
                slope[k, later] -= found
                if k < later:
                    slope[later, k] -= found
