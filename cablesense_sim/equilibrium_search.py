"""Equilibria, compiled: cables and joint torques in a pose, and the search for equilibria.

The quantities of a pose are those of `cablesense_sim.kinematics`, for few arms that go from rest
to rest, where NumPy's calls would cost more than the arithmetic.

Equilibria are found by Newton's method on the potential (see `equilibrium`), case by case. It is
continuously differentiable, and twice so between kinks, where a cable goes slack. Newton's method
with exact second derivatives and a line search suits that (Nocedal and Wright, Numerical
Optimization, 2006, sections 3.4 and 6.2), with two additions. Steps that cross a kink are cut from
their far end, and a saddle of the potential is left.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_sim.compiled import compiled
from cablesense_sim.linear_equations import factorise, solve
from cablesense_sim.mechanism import Mechanism

_TOUCHING_M = 1e-9
"""Distance at which two guides count as touching: the length of a cable is divided by."""
_MAX_ITERATIONS = 100
"""Of Newton's method: a search that needs more does not converge."""
_ARMIJO = 1e-4
"""Share of the linear decrease that a step must achieve (Armijo's rule)."""
_SHORTEST_STEP = 1e-9
"""Fraction of a step at which a line search gives up."""
_LEAST_CUT = 0.01
"""Smallest factor of a step that goes too far."""
_LARGEST_CUT = 0.9
"""Largest factor of a step that goes too far: it must become shorter."""
_LONGEST_TURN_RAD = 0.1
"""Of a joint in one step: springs and cables are then near enough to their linear model."""
_LEAST_ESCAPE_RAD = 1e-3
"""Turn away from a saddle, at least: the gradient is zero there."""
_FLATTEST = 1e-6
"""Least curvature of an escape along a direction, as a share of the largest."""
_ROUNDING = 1e-13
"""Relative rounding of the potential, in addition to that of the cables' stretches."""


class Plates(NamedTuple):
    """Guide plates of P arms, which hardly differ."""

    offset_m: float  # of the plates before and after each joint centre
    holes_m: Array  # (P, M, N, 4) y and z before a joint, and behind it
    passed: NDArray[np.int64]  # (M,) how many joints a cable passes, from the first on


class Springs(NamedTuple):
    """Plates of one arm, stiffness of its M cables, and that of its 2N joint axes."""

    plates: Plates
    cable_n_m: Array
    joint_n_m_rad: Array


class Pose(NamedTuple):
    """P arms in a pose."""

    span_m: Array  # (P, M, N) cable between the plates of a joint, zero where none passes
    by_turn_m: Array  # (P, M, N, 2) their derivative by the two angles of the joint
    by_turns_m: Array  # (P, M, N, 3) the second, by pitch, both and yaw
    bend_rad: Array  # (P, M, N, 2) turn of a cable at the guides before and behind a joint
    axis: Array  # (P, N, 3) of each segment, unit vector
    joint_axis: Array  # (P, 2N, 3) of each joint angle, unit vector


class Imbalance(NamedTuple):
    """Joint torques of P arms in a pose."""

    torque_n_m: Array  # (P, 2N) left unbalanced
    slope_n_m: Array  # (P, 2N, 2N) its derivative by the joint angles


def plates_of(mechanism: Mechanism, count: int) -> Plates:
    """The plates of `count` arms, stacked in one mechanism."""
    before, after = mechanism.plate_holes_m
    shape = count, mechanism.cable_count, mechanism.segment_count
    holes = [np.broadcast_to(each, shape) for each in (*before, *after)]
    passed = np.array(mechanism.cable_segment, np.int64)
    return Plates(mechanism.plate_offset_m, np.stack(holes, axis=-1), passed)


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
        cos = np.cos(angles_rad[p])
        sin = np.sin(angles_rad[p])
        turn_axes(cos, sin, pose.axis[p], pose.joint_axis[p])
        for m in range(cables):
            for n in range(plates.passed[m]):
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
    o = offset_m
    (y, z, v, w) = holes_m
    cos_a, cos_b = cos
    sin_a, sin_b = sin
    x1 = o * cos_b - v * sin_b
    y1 = o * sin_b + v * cos_b
    along = o * cos_a + z * sin_a
    across = o * sin_a - z * cos_a
    squared = 2.0 * o * o + (y * y + z * z + v * v + w * w)
    squared += 2.0 * (x1 * along + w * across - y * y1)
    span = np.sqrt(max(squared, _TOUCHING_M**2))
    by_a = (w * along - x1 * across) / span
    by_b = -(y1 * along + y * x1) / span
    by_turn_m[0] = by_a
    by_turn_m[1] = by_b
    by_turns_m[0] = -(x1 * along + w * across + by_a * by_a) / span
    by_turns_m[1] = (y1 * across - by_a * by_b) / span
    by_turns_m[2] = (y * y1 - x1 * along - by_b * by_b) / span
    return span, o + x1 * cos_a + w * sin_a, o + along * cos_b - y * sin_b


@compiled
def stretch_m(
    plates: Plates,
    m: int,
    slack_m: float,
    cos: Array,
    sin: Array,
    lever_m: Array,
    by_turns_m: Array,
) -> float:
    """A cable's stretch, beyond spans of the sum `slack_m`, at the angles of the first of P arms.

    Writes its derivative (2N,), and the second ones (N, 3) of its spans, as of `Pose`.
    """
    stretch = -slack_m
    for n in range(plates.passed[m]):
        turns = slice(2 * n, 2 * n + 2)
        holes = plates.holes_m[0, m, n]
        stretch += span_m(
            plates.offset_m, holes, cos[turns], sin[turns], lever_m[turns], by_turns_m[n]
        )[0]
    return stretch


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
    x = 0.0
    y = 0.0
    z = 0.0
    for n in range(len(axis) - 1, -1, -1):
        (a, b, c) = axis[n]
        (f, g, h) = arms_n_m[n]
        x = x + b * h - c * g
        y = y + c * f - a * h
        z = z + a * g - b * f
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
) -> Imbalance:
    """Torques of tensions (P, M, N) in the spans, with their derivative (P, M, N, N) by these.

    Loads are generalised forces (P, N, 3) on the segments' axes; what joints resist by themselves
    (P, 2N) has a slope by each joint's own angle.
    """
    arms, cables, joints = along_n.shape
    torque = resisted_n_m.copy()
    slope = np.zeros((arms, 2 * joints, 2 * joints))
    for p in range(arms):
        take_load_torque(pose.axis[p], pose.joint_axis[p], arms_n_m[p], torque[p])
        arm_slope = slope[p]
        for k in range(2 * joints):
            arm_slope[k, k] = resisted_slope_n_m[p, k]
        for m in range(cables):
            for n in range(joints):
                pitch, crossed, yaw = along_n[p, m, n] * pose.by_turns_m[p, m, n]
                arm_slope[2 * n, 2 * n] += pitch
                arm_slope[2 * n, 2 * n + 1] += crossed
                arm_slope[2 * n + 1, 2 * n] += crossed
                arm_slope[2 * n + 1, 2 * n + 1] += yaw
            for i in range(2 * joints):
                lever = pose.by_turn_m[p, m, i // 2, i % 2]
                torque[p, i] += along_n[p, m, i // 2] * lever
                for j in range(2 * joints):
                    stiffness = by_span_n_m[p, m, i // 2, j // 2]
                    arm_slope[i, j] += lever * stiffness * pose.by_turn_m[p, m, j // 2, j % 2]
        take_load_slope(pose.axis[p], pose.joint_axis[p], arms_n_m[p], arm_slope)
    return Imbalance(torque, slope)


@compiled
def take_load_slope(axis: Array, joint_axis: Array, arms_n_m: Array, slope: Array) -> None:
    """Takes the second derivative of `sum_n A_n · x_n` off a slope (2N, 2N).

    For a joint axis k before l it is A_n · (w_k x (w_l x x_n)), summed over the segments beyond.
    """
    outer = np.zeros((3, 3))
    along = 0.0
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
                steeper = 0.0
                for i in range(3):
                    steeper += joint_axis[k, i] * turned[i]
                slope[k, later] -= steeper
                if k < later:
                    slope[later, k] -= steeper


class _Case(NamedTuple):
    """One case at one pose, overwritten from step to step."""

    slack_m: Array  # (M,), as `search_equilibrium` takes it
    arms_n_m: Array  # (N, 3), likewise
    tension_n: Array  # (M,)
    gradient_n_m: Array  # (2N,) of the potential
    hessian_n_m: Array  # (2N, 2N) of the potential, the lower half
    axis: Array  # (N, 3), as in `Pose`
    joint_axis: Array  # (2N, 3), likewise
    jacobian_m: Array  # (M, 2N) of the cable lengths
    second_m: Array  # (N, 3) second derivatives of one cable's spans


@compiled
def search_equilibrium(
    springs: Springs, enough: float, rounding_m: float, slack_m: Array, arms: Array, angles: Array
) -> tuple[Array, Array, Array, NDArray[np.int64]]:
    """Angles (B, 2N), tensions (B, M), residuals (B,) and steps (B,) for a batch.

    A case ends when its residual is at most `enough` and its pose stable. The residual of one
    without a stable pose is infinite.

    Args:
        springs: those of the arm.
        enough: largest joint torque that may stay unbalanced, N·m.
        rounding_m: what double precision leaves open of a stretch.
        slack_m: (B, M) sums of the spans at which cables are just slack, m.
        arms: (B, N, 3) loads on the segments' axes, N·m, as `kinematics.load_arms` has them.
        angles: (B, 2N) to begin at, rad; they become those of the answer.
    """
    (count, cables) = slack_m.shape
    joints = arms.shape[1]
    tensions = np.zeros((count, cables))
    residual = np.full(count, np.inf)
    iterations = np.zeros(count, np.int64)
    case = _Case(
        np.zeros(cables),
        np.zeros((joints, 3)),
        np.zeros(cables),
        np.zeros(2 * joints),
        np.zeros((2 * joints, 2 * joints)),
        np.zeros((joints, 3)),
        np.zeros((2 * joints, 3)),
        np.zeros((cables, 2 * joints)),
        np.zeros((joints, 3)),
    )
    for b in range(count):
        case.slack_m[:] = slack_m[b]
        case.arms_n_m[:] = arms[b]
        potential = _look(springs, angles[b], case)
        for iteration in range(_MAX_ITERATIONS + 1):
            largest = np.abs(case.gradient_n_m).max()
            root = case.hessian_n_m.copy()
            stable = factorise(root)
            tensions[b] = case.tension_n
            iterations[b] = iteration
            # balanced on a saddle of the potential is not at rest
            residual[b] = largest if stable else np.inf
            if stable and largest <= enough:
                break
            if stable:
                turn = -case.gradient_n_m
                solve(root, turn.reshape(1, -1))
            else:
                turn = escape_step(case.hessian_n_m, case.gradient_n_m)
            turn *= min(1.0, _LONGEST_TURN_RAD / max(np.abs(turn).max(), 1e-300))
            room = _ROUNDING * (abs(potential) + 1.0) + rounding_m * case.tension_n.sum()
            potential = _line_search(springs, angles[b], turn, potential, room, case)
            if not np.isfinite(potential):
                break
    return angles, tensions, residual, iterations


@compiled
def _line_search(
    springs: Springs, angles: Array, turn: Array, start: float, room: float, case: _Case
) -> float:
    """Armijo backtracking: turns the angles, in place, and gives the potential there.

    A step is too long where it pulls cables taut that the second derivatives took for slack. It is
    cut by Newton's method along the line, from its far end with the cables taut there. A cut from
    the near end would stop short of the kink, again and again. Near the equilibrium, where the
    potential is flat to rounding, full steps pass. The potential is infinite, and the angles are
    unchanged, if no step lowers it.
    """
    before = angles.copy()
    slope = (turn * case.gradient_n_m).sum()
    fraction = 1.0
    while True:
        angles[:] = before + fraction * turn
        potential = _look(springs, angles, case)
        if potential - start <= _ARMIJO * fraction * slope + room:
            return potential
        if not fraction > _SHORTEST_STEP:
            angles[:] = before
            return np.inf
        curvature = 0.0
        for m in range(len(case.tension_n)):
            if case.tension_n[m] > 0.0:
                curvature += springs.cable_n_m[m] * (case.jacobian_m[m] * turn).sum() ** 2
        excess = (case.gradient_n_m * turn).sum()
        cut = 1.0 - excess / max(fraction * curvature, 1e-300)
        fraction *= min(max(cut, _LEAST_CUT), _LARGEST_CUT)


@compiled
def _look(springs: Springs, angles: Array, case: _Case) -> float:
    """The potential at a pose, and everything of the case."""
    plates = springs.plates
    joints = len(case.axis)
    second = case.second_m
    gradient = case.gradient_n_m
    hessian = case.hessian_n_m
    cos = np.cos(angles)
    sin = np.sin(angles)
    potential = 0.0
    hessian[:] = 0.0
    for k in range(2 * joints):
        gradient[k] = springs.joint_n_m_rad[k] * angles[k]
        hessian[k, k] = springs.joint_n_m_rad[k]
        potential += 0.5 * gradient[k] * angles[k]
    for m in range(len(case.tension_n)):
        passed = plates.passed[m]
        lever = case.jacobian_m[m]
        stretch = stretch_m(plates, m, case.slack_m[m], cos, sin, lever, second)
        stiffness = springs.cable_n_m[m]
        tension = stiffness * max(stretch, 0.0)
        case.tension_n[m] = tension
        if tension == 0.0:
            continue
        potential += 0.5 * tension * stretch
        for k in range(2 * passed):
            gradient[k] += tension * lever[k]
            for j in range(k + 1):
                hessian[k, j] += stiffness * lever[k] * lever[j]
        for n in range(passed):
            hessian[2 * n, 2 * n] += tension * second[n, 0]
            hessian[2 * n + 1, 2 * n] += tension * second[n, 1]
            hessian[2 * n + 1, 2 * n + 1] += tension * second[n, 2]
    turn_axes(cos, sin, case.axis, case.joint_axis)
    take_load_torque(case.axis, case.joint_axis, case.arms_n_m, gradient)
    take_load_slope(case.axis, case.joint_axis, case.arms_n_m, hessian)
    for n in range(joints):
        for i in range(3):
            potential -= case.arms_n_m[n, i] * case.axis[n, i]
    return potential


@compiled
def escape_step(hessian: Array, gradient: Array) -> Array:
    """A step (K,) down a function that curves down in some direction, by the absolute curvatures.

    There the arm would not stay, balanced or not, so the step along such a direction has a least
    length. Only the lower half of the Hessian (K, K) is read.
    """
    whole = hessian.copy()
    for i in range(len(whole)):
        for j in range(i):
            whole[j, i] = whole[i, j]
    values, vectors = np.linalg.eigh(whole)
    least = _FLATTEST * np.abs(values).max()
    step = np.zeros(len(gradient))
    for k in range(len(values)):
        along = (vectors[:, k] * gradient).sum()
        length = -along / max(abs(values[k]), least)
        if values[k] < 0.0 and abs(length) < _LEAST_ESCAPE_RAD:
            length = _LEAST_ESCAPE_RAD if along < 0.0 else -_LEAST_ESCAPE_RAD
        step += length * vectors[:, k]
    return step
