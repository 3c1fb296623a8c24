"""Newton's method on the potential without its safeguards, compiled, for large batches.

A diagnosis looks for a million rests, nearly all of them a few whole steps away. The formulas are
those of `cablesense_sim.kinematics` and `equilibrium`; a case that needs more than whole steps
down the potential is left to `cablesense_sim.rest_search`, which would have taken the same ones.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_sim.compiled import compiled
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.rest_pose import (
    Plates,
    plates_of,
    span_m,
    take_load_slope,
    take_load_torque,
    turn_axes,
)
from cablesense_sim.rest_search import ARMIJO, LONGEST_TURN_RAD, ROUNDING

_MOST_STEPS = 12


class _Case(NamedTuple):
    """What is known of one pose, overwritten from step to step.

    Attributes:
        tension_n: (M,).
        gradient_n_m, hessian_n_m: (2N,) and (2N, 2N) of the potential.
        axis, joint_axis: (N, 3) and (2N, 3) as in `rest_pose.Pose`.
        by_turn_m, by_turns_m: (2N,) and (N, 3) of one cable's length.
    """

    tension_n: Array
    gradient_n_m: Array
    hessian_n_m: Array
    axis: Array
    joint_axis: Array
    by_turn_m: Array
    by_turns_m: Array


def whole_steps_to_rest(
    mechanism: Mechanism,
    enough_n_m: float,
    rounding_m: float,
    rest_m: Array,
    arms_n_m: Array,
    start_rad: Array,
) -> tuple[Array, Array, Array, NDArray[np.int64]]:
    """As `rest_search.search_rest`; the residual of a case that needs safeguards is infinite.

    `arms_n_m` (B, N, 3) are the loads on the segments' axes, and `rounding_m` is what double
    precision leaves open of a stretch.
    """
    return _to_rest(
        plates_of(mechanism, 1),
        np.array(mechanism.stiffness_n_m, float),
        np.repeat(mechanism.joint_stiffness_n_m_rad, 2).astype(float),
        enough_n_m,
        rounding_m,
        np.array(rest_m),
        np.array(arms_n_m),
        np.array(start_rad),
    )


@compiled
def _to_rest(
    plates: Plates,
    stiffness: Array,
    spring: Array,
    enough: float,
    rounding_m: float,
    rest: Array,
    arms: Array,
    angles: Array,
) -> tuple[Array, Array, Array, NDArray[np.int64]]:
    count, cables = rest.shape
    joints = arms.shape[1]
    tensions, residual = np.zeros((count, cables)), np.full(count, np.inf)
    iterations = np.zeros(count, np.int64)
    case = _Case(
        np.zeros(cables),
        np.zeros(2 * joints),
        np.zeros((2 * joints, 2 * joints)),
        np.zeros((joints, 3)),
        np.zeros((2 * joints, 3)),
        np.zeros(2 * joints),
        np.zeros((joints, 3)),
    )
    for b in range(count):
        highest = np.inf
        for iteration in range(_MOST_STEPS):
            potential = _look(plates, stiffness, spring, rest[b], arms[b], angles[b], case)
            if not potential <= highest:
                break
            largest, downhill = np.abs(case.gradient_n_m).max(), -case.gradient_n_m
            if not _solved(case.hessian_n_m, downhill):
                break
            if largest <= enough:
                tensions[b], residual[b], iterations[b] = case.tension_n, largest, iteration
                break
            turn = downhill
            turn *= min(1.0, LONGEST_TURN_RAD / max(np.abs(turn).max(), 1e-300))
            highest = potential + ARMIJO * (turn * case.gradient_n_m).sum()
            highest += ROUNDING * (abs(potential) + 1.0) + rounding_m * case.tension_n.sum()
            angles[b] += turn
    return angles, tensions, residual, iterations


@compiled
def _look(
    plates: Plates,
    stiffness: Array,
    spring: Array,
    rest: Array,
    arms: Array,
    angles: Array,
    case: _Case,
) -> float:
    """The potential at a pose, and everything of the case; the lower half of the Hessian."""
    joints, cables = len(arms), len(rest)
    gradient, hessian = case.gradient_n_m, case.hessian_n_m
    lever, second = case.by_turn_m, case.by_turns_m
    cos, sin = np.cos(angles), np.sin(angles)
    potential = 0.0
    hessian[:] = 0.0
    for k in range(2 * joints):
        gradient[k] = spring[k] * angles[k]
        hessian[k, k] = spring[k]
        potential += 0.5 * gradient[k] * angles[k]
    for m in range(cables):
        stretch, passed = -rest[m], 0
        while passed < joints and plates.passes[m, passed]:
            n, both = passed, slice(2 * passed, 2 * passed + 2)
            holes = plates.holes_m[0, m, n]
            stretch += span_m(
                plates.offset_m, holes, cos[both], sin[both], lever[both], second[n]
            )[0]
            passed += 1
        tension = stiffness[m] * max(stretch, 0.0)
        case.tension_n[m] = tension
        if tension == 0.0:
            continue
        potential += 0.5 * tension * stretch
        for k in range(2 * passed):
            gradient[k] += tension * lever[k]
            for j in range(k + 1):
                hessian[k, j] += stiffness[m] * lever[k] * lever[j]
        for n in range(passed):
            hessian[2 * n, 2 * n] += tension * second[n, 0]
            hessian[2 * n + 1, 2 * n] += tension * second[n, 1]
            hessian[2 * n + 1, 2 * n + 1] += tension * second[n, 2]
    turn_axes(cos, sin, case.axis, case.joint_axis)
    take_load_torque(case.axis, case.joint_axis, arms, gradient)
    take_load_slope(case.axis, case.joint_axis, arms, hessian)
    for n in range(joints):
        for i in range(3):
            potential -= arms[n, i] * case.axis[n, i]
    return potential


@compiled
def _solved(hessian: Array, values: Array) -> bool:
    """Solves in place by Cholesky of the lower half; whether that is positive definite."""
    count = len(values)
    for k in range(count):
        for i in range(k, count):
            for j in range(k):
                hessian[i, k] -= hessian[i, j] * hessian[k, j]
        if not hessian[k, k] > 0.0:
            return False
        root = np.sqrt(hessian[k, k])
        for i in range(k, count):
            hessian[i, k] /= root
        for j in range(k):
            values[k] -= hessian[k, j] * values[j]
        values[k] /= root
    for k in range(count - 1, -1, -1):
        for i in range(k + 1, count):
            values[k] -= hessian[i, k] * values[i]
        values[k] /= hessian[k, k]
    return True
