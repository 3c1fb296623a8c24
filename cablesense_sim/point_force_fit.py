"""The forces at contact points of an arm at rest that its readings show, compiled.

The lengths of the taut cables determine the pose, by Gauss-Newton steps. The joint torques there
determine the forces. Variances are in those of a reading.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_sim import kinematics
from cablesense_sim.compiled import compiled, factorise, solve
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.rest import Springs, springs_of, stretch_m, take_load_torque, turn_axes

_SLACK_WEIGHT = 1e-5
"""A slack cable's length has this weight in the fit of the pose, which it holds where few cables
are taut."""
_POSE_STEPS, _POSE_FOUND_RAD = 8, 3e-5  # each step squares the error of the pose


class PointArm(NamedTuple):
    """An arm with contact points."""

    springs: Springs  # its cables and joints
    weight_n_m: Array  # (N, 3) of the segments, as `kinematics.load_arms` has it
    length_m: Array  # (N,) of each segment
    contact_m: Array  # (N,) from its joint centre to its contact point


class Resting(NamedTuple):
    """A command at which the arm rests."""

    angles_rad: Array  # (2N,)
    axes: Array  # (N, 3, 3) segment frames to base
    rest_m: Array  # (M,) sums of the spans at which cables are just slack


class _Pose(NamedTuple):
    """The pose that readings show."""

    angles_rad: Array  # (2N,)
    axis: Array  # (N, 3), as in `rest.Pose`, before the last step, which is small
    joint_axis: Array  # (2N, 3), likewise
    taut: NDArray[np.bool_]  # (M,) which cables are
    lever_m: Array  # (M, 2N) derivative of the cable lengths by the angles, likewise
    elastic_n: Array  # (M,) tensions, negative where a slack cable lacks length
    root: Array  # (2N, 2N) lower Cholesky factor of the information of the angles


def point_arm(mechanism: Mechanism) -> PointArm:
    """The arm of a mechanism."""
    unloaded = np.zeros((mechanism.segment_count, 3))
    return PointArm(
        springs_of(mechanism),
        kinematics.load_arms(mechanism, unloaded),
        np.array(mechanism.segment_length_m, float),
        np.array(mechanism.contact_m, float),
    )


@compiled
def fit_point_forces(
    arm: PointArm,
    at: Resting,
    reading_n: Array,
    taut_above_n: float,
    segments: NDArray[np.int64],
    along: Array,
) -> tuple[Array, float]:
    """The forces (K, 3) on segments (K,), from 0 on, that fit readings (M,) best.

    They are along the axes of the segments at the command. `along` (K,) is the information of each
    axial component before the readings, which are of a taut cable above `taut_above_n`. Gives the
    sum of the squared residuals, N², too.
    """
    pose = _read_pose(arm.springs, at, reading_n, taut_above_n)
    joints, squared = len(pose.angles_rad), 0.0
    torque, stiffness = arm.springs.joint_n_m_rad * pose.angles_rad, np.zeros((joints, joints))
    variance = np.zeros((joints, joints))
    for m in range(len(reading_n)):
        lever, tension, changed, scale = pose.lever_m[m], reading_n[m], variance, 1.0
        squared += (tension - max(pose.elastic_n[m], 0.0)) ** 2
        if pose.taut[m]:
            tension, changed, scale = pose.elastic_n[m], stiffness, arm.springs.cable_n_m[m]
        for i in range(joints):
            torque[i] += tension * lever[i]
            for j in range(joints):
                changed[i, j] += scale * lever[i] * lever[j]
    take_load_torque(pose.axis, pose.joint_axis, arm.weight_n_m, torque)
    turned = stiffness.copy()
    solve(pose.root, turned)
    variance += turned @ stiffness
    factorise(variance)

    columns = np.zeros((3 * len(segments), joints))
    for k in range(len(segments)):
        _unit_torques(arm, at, pose, segments[k], columns[3 * k : 3 * k + 3])
    weighted = columns.copy()
    solve(variance, weighted)
    information, force = weighted @ columns.T, weighted @ torque
    for k in range(len(segments)):
        information[3 * k, 3 * k] += along[k]
    factorise(information)
    solve(information, force.reshape(1, -1))
    torque -= force @ columns
    weighted_torque = torque.copy()
    solve(variance, weighted_torque.reshape(1, -1))
    squared += (weighted_torque * torque).sum() + (along * force[::3] ** 2).sum()
    return force.reshape(-1, 3), squared


@compiled
def _unit_torques(arm: PointArm, at: Resting, pose: _Pose, n: int, torques: Array) -> None:
    """Write the joint torques (3, 2N) of unit forces at the contact point of segment n."""
    axes, arm_m = at.axes[n], arm.contact_m[n] * pose.axis[n]
    for joint in range(n, -1, -1):
        for k in (2 * joint, 2 * joint + 1):
            (a, b, c), (x, y, z) = pose.joint_axis[k], arm_m
            moved = b * z - c * y, c * x - a * z, a * y - b * x
            for i in range(3):
                torques[i, k] = (
                    moved[0] * axes[0, i] + moved[1] * axes[1, i] + moved[2] * axes[2, i]
                )
        if joint:
            arm_m = arm_m + arm.length_m[joint - 1] * pose.axis[joint - 1]


@compiled
def _read_pose(springs: Springs, at: Resting, reading_n: Array, taut_above_n: float) -> _Pose:
    """The pose whose tensions are nearest to the readings (M,).

    Cables that are read as taut determine it, and then also those that it would make taut.
    """
    cables, segments = len(springs.cable_n_m), len(at.axes)
    joints, angles, turn = 2 * segments, at.angles_rad.copy(), np.zeros(2 * segments)
    axis, joint_axis = np.zeros((segments, 3)), np.zeros((joints, 3))
    taut, lever, elastic = reading_n > taut_above_n, np.zeros((cables, joints)), np.zeros(cables)
    information, by_turns = np.zeros((joints, joints)), np.zeros((segments, 3))
    for step in range(_POSE_STEPS):
        cos, sin = np.cos(angles), np.sin(angles)
        information[:], turn[:] = 0.0, 0.0
        for m in range(cables):
            stiffness = springs.cable_n_m[m]
            stretch = stretch_m(springs.plates, m, at.rest_m[m], cos, sin, lever[m], by_turns)
            elastic[m] = stiffness * stretch
            taut[m] = reading_n[m] > taut_above_n or (step > 0 and stretch > 0.0)
            missing, weight = reading_n[m] - elastic[m], stiffness
            if not taut[m]:
                missing, weight = min(-elastic[m], 0.0), _SLACK_WEIGHT * stiffness
            for i in range(joints):
                turn[i] += weight * lever[m, i] * missing
                for j in range(i + 1):
                    information[i, j] += weight * stiffness * lever[m, i] * lever[m, j]
        factorise(information)
        solve(information, turn.reshape(1, -1))
        angles += turn
        if step > 0 and np.abs(turn).max() < _POSE_FOUND_RAD:
            break
    for m in range(cables):
        elastic[m] += springs.cable_n_m[m] * (lever[m] * turn).sum()
    turn_axes(cos, sin, axis, joint_axis)
    return _Pose(angles, axis, joint_axis, taut, lever, elastic, information)
