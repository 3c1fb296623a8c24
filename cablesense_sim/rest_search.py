"""The search for equilibria, compiled: Newton's method on the potential, case by case.

The potential (see `equilibrium`) is continuously differentiable, and twice so between kinks, where
a cable goes slack. Newton's method with exact second derivatives and a line search suits that
(Nocedal and Wright, Numerical Optimization, 2006, sections 3.4 and 6.2), with two additions. Steps
that cross a kink are cut from their far end, and a saddle of the potential is left.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_sim.cholesky import factorise, solve
from cablesense_sim.compiled import compiled
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.rest_pose import (
    Springs,
    span_m,
    springs_of,
    take_load_slope,
    take_load_torque,
    turn_axes,
)

_MAX_ITERATIONS = 100
_ARMIJO = 1e-4
_SHORTEST_STEP = 1e-9
_LEAST_CUT, _LARGEST_CUT = 0.01, 0.9
_LONGEST_TURN_RAD = 0.1
_LEAST_ESCAPE_RAD = 1e-3
_ROUNDING = 1e-13
"""Relative rounding of the potential, in addition to that of the cables' stretches."""


class _Case(NamedTuple):
    """One case at one pose, overwritten from step to step.

    Attributes:
        rest_m, arms_n_m: (M,) and (N, 3) of the case, as `search_rest` takes them.
        tension_n: (M,).
        gradient_n_m, hessian_n_m: (2N,) and (2N, 2N) of the potential, of the latter the lower
            half.
        axis, joint_axis: (N, 3) and (2N, 3) as in `rest_pose.Pose`.
        jacobian_m: (M, 2N) of the cable lengths.
        second_m: (N, 3) second derivatives of one cable's spans.
    """

    rest_m: Array
    arms_n_m: Array
    tension_n: Array
    gradient_n_m: Array
    hessian_n_m: Array
    axis: Array
    joint_axis: Array
    jacobian_m: Array
    second_m: Array


def search_rest(
    mechanism: Mechanism,
    enough_n_m: float,
    rounding_m: float,
    rest_m: Array,
    arms_n_m: Array,
    start_rad: Array,
) -> tuple[Array, Array, Array, NDArray[np.int64]]:
    """Angles (B, 2N), tensions (B, M), residuals (B,) and steps (B,) for a batch.

    A case ends when its residual is at most `enough_n_m` and its pose stable. The residual of one
    without a stable pose is infinite.

    Args:
        mechanism: the arm.
        enough_n_m: largest joint torque that may stay unbalanced.
        rounding_m: what double precision leaves open of a stretch.
        rest_m: (B, M) sums of the spans at which cables are just slack.
        arms_n_m: (B, N, 3) loads on the segments' axes, `kinematics.load_arms`.
        start_rad: (B, 2N) angles to begin at.
    """
    given = np.array(rest_m), np.array(arms_n_m), np.array(start_rad)
    return _searched(springs_of(mechanism), enough_n_m, rounding_m, *given)


@compiled
def _searched(
    springs: Springs, enough: float, rounding_m: float, rest: Array, arms: Array, angles: Array
) -> tuple[Array, Array, Array, NDArray[np.int64]]:
    (count, cables), joints = rest.shape, arms.shape[1]
    tensions, residual = np.zeros((count, cables)), np.full(count, np.inf)
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
        case.rest_m[:] = rest[b]
        case.arms_n_m[:] = arms[b]
        potential = _look(springs, angles[b], case)
        for iteration in range(_MAX_ITERATIONS + 1):
            largest, root = np.abs(case.gradient_n_m).max(), case.hessian_n_m.copy()
            stable = factorise(root)
            tensions[b], iterations[b] = case.tension_n, iteration
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
    before, slope = angles.copy(), (turn * case.gradient_n_m).sum()
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
    plates, joints, second = springs.plates, len(case.axis), case.second_m
    gradient, hessian = case.gradient_n_m, case.hessian_n_m
    cos, sin = np.cos(angles), np.sin(angles)
    potential = 0.0
    hessian[:] = 0.0
    for k in range(2 * joints):
        gradient[k] = springs.joint_n_m_rad[k] * angles[k]
        hessian[k, k] = springs.joint_n_m_rad[k]
        potential += 0.5 * gradient[k] * angles[k]
    for m in range(len(case.tension_n)):
        stretch, passed, lever = -case.rest_m[m], 0, case.jacobian_m[m]
        while passed < joints and plates.passes[m, passed]:
            both, holes = slice(2 * passed, 2 * passed + 2), plates.holes_m[0, m, passed]
            stretch += span_m(
                plates.offset_m, holes, cos[both], sin[both], lever[both], second[passed]
            )[0]
            passed += 1
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
    least = 1e-6 * np.abs(values).max()
    step = np.zeros(len(gradient))
    for k in range(len(values)):
        along = (vectors[:, k] * gradient).sum()
        length = -along / max(abs(values[k]), least)
        if values[k] < 0.0 and abs(length) < _LEAST_ESCAPE_RAD:
            length = _LEAST_ESCAPE_RAD if along < 0.0 else -_LEAST_ESCAPE_RAD
        step += length * vectors[:, k]
    return step
