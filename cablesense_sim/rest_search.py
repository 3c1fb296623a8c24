"""The search for a resting pose: Newton's method on the potential, for many cases at once.

The potential (see `equilibrium`) is continuously differentiable, and twice so between kinks, where
a cable goes slack. Newton's method with exact second derivatives and a line search suits that
(Nocedal and Wright, Numerical Optimization, 2006, sections 3.4 and 6.2), with two additions: steps
that cross a kink are cut from their far end, and a saddle of the potential is left.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_sim import kinematics
from cablesense_sim.mechanism import Mechanism

MAX_ITERATIONS = 100
ARMIJO = 1e-4
_SHORTEST_STEP = 1e-9
_CUT = (0.01, 0.9)
LONGEST_TURN_RAD = 0.1
ROUNDING = 1e-13
"""Of the potential, beside what cables' stretches leave open."""
_LEAST_ESCAPE_RAD = 1e-3


def rounding_m(mechanism: Mechanism) -> float:
    """What double precision leaves open of a cable's stretch, with some room.

    Where plates are wide and close together, a span is a small difference of large squares.
    """
    apart = 2.0 * mechanism.plate_offset_m
    wide = float(np.hypot(mechanism.hole_y_m, mechanism.hole_z_m).max())
    return 4.0 * float(np.finfo(float).eps) * mechanism.segment_count * max(apart, wide**2 / apart)


def rounding_n_m(mechanism: Mechanism) -> float:
    """What that leaves open of a joint torque."""
    radius = np.hypot(mechanism.hole_y_m, mechanism.hole_z_m)
    return rounding_m(mechanism) * float((mechanism.stiffness_n_m * radius).max())


class _Point(NamedTuple):
    """A batch of poses under commands and loads, with what the method asks of each of them."""

    angles_rad: Array
    span: kinematics.Spans
    pose: kinematics.Chain
    tension_n: Array
    potential_j: Array
    gradient_n_m: Array

    @classmethod
    def at(cls, mechanism: Mechanism, angles: Array, rest: Array, arms: Array) -> _Point:
        """Angles (B, 2N), cables' spans at rest (B, M), load arms (B, N, 3)."""
        span, pose = kinematics.spans(mechanism, angles), kinematics.chain(mechanism, angles)
        stretch = np.maximum(span.length_m.sum(-1) - rest, 0.0)
        tension = mechanism.stiffness_n_m * stretch
        cables = (tension[..., None, :] @ kinematics.interleave(span))[..., 0, :]
        spring = np.repeat(mechanism.joint_stiffness_n_m_rad, 2, axis=-1) * angles
        return cls(
            angles_rad=angles,
            span=span,
            pose=pose,
            tension_n=tension,
            potential_j=0.5 * (tension * stretch).sum(-1)
            + 0.5 * (spring * angles).sum(-1)
            - (arms * pose.rotation[..., 0]).sum((-2, -1)),
            gradient_n_m=cables + spring - kinematics.axis_torques_n_m(pose, arms),
        )


def _rows(batch: Any, rows: NDArray[Any]) -> Any:
    """Some rows of every array of a (nested) tuple of arrays."""
    return type(batch)(
        *(_rows(part, rows) if isinstance(part, tuple) else part[rows] for part in batch)
    )


def _replace_rows(batch: Any, rows: NDArray[Any], others: Any) -> None:
    """Write `others` over those rows, in place."""
    for part, other in zip(batch, others, strict=True):
        if isinstance(part, tuple):
            _replace_rows(part, rows, other)
        else:
            part[rows] = other


def search_rest(
    mechanism: Mechanism, enough_n_m: float, rest: Array, forces: Array, start: Array
) -> tuple[Array, Array, Array, NDArray[np.int64]]:
    """Angles (B, 2N), tensions (B, M), residuals (B,) and steps (B,) for a batch.

    `rest` (B, M) are the spans' lengths at which the cables are just slack, `start` (B, 2N) the
    angles to begin at. A case leaves when its residual is at most `enough_n_m` and its pose
    stable; the residual of one that finds no stable pose is infinite.
    """
    arms = kinematics.load_arms(mechanism, forces)
    angles, tensions = np.empty_like(start), np.empty_like(rest)
    residual = np.empty(len(start))
    stable = np.zeros(len(start), dtype=bool)
    iterations = np.zeros(len(start), dtype=np.int64)
    live = np.arange(len(start))
    point = _Point.at(mechanism, start, rest, arms)
    for iteration in range(MAX_ITERATIONS + 1):
        angles[live], tensions[live] = point.angles_rad, point.tension_n
        residual[live] = np.abs(point.gradient_n_m).max(axis=-1)
        iterations[live] = iteration
        hessian = hessian_n_m(mechanism, point.span, point.pose, point.tension_n, arms[live])
        stable[live] = _is_positive_definite(hessian)
        going = ~(stable[live] & (residual[live] <= enough_n_m))
        if iteration == MAX_ITERATIONS or not going.any():
            break
        live, point, hessian = live[going], _rows(point, going), hessian[going]
        step = descent_step(hessian, point.gradient_n_m, stable[live])
        point, moved = _line_search(mechanism, point, step, rest[live], arms[live])
        live, point = live[moved], _rows(point, moved)
    residual[~stable] = np.inf  # balanced on a saddle of the potential is not at rest
    return angles, tensions, residual, iterations


def hessian_n_m(
    mechanism: Mechanism,
    span: kinematics.Spans,
    pose: kinematics.Chain,
    tension: Array,
    arms: Array,
) -> Array:
    """Second derivative (..., 2N, 2N) of the potential."""
    jacobian = kinematics.interleave(span)
    taut = mechanism.stiffness_n_m * (tension > 0.0)
    hessian = np.swapaxes(jacobian, -1, -2) @ (taut[..., None] * jacobian)
    joints = np.arange(mechanism.segment_count)
    for row, column, second in span.second_derivatives:
        block = (tension[..., None, :] @ second)[..., 0, :]
        if row == column:
            block = block + mechanism.joint_stiffness_n_m_rad
        hessian[..., 2 * joints + row, 2 * joints + column] += block
    return hessian - load_hessian(pose, arms)


def load_hessian(pose: kinematics.Chain, arms: Array) -> Array:
    """Second derivative (..., 2N, 2N) of `sum_n A_n · x_n` by the joint angles, N·m.

    For axis k before axis l it is w_k x (w_l x x_n).
    """
    x = pose.rotation[..., 0]
    outer = x[..., :, None] * arms[..., None, :]
    along = (x * arms).sum(-1)
    outer = np.repeat(np.cumsum(outer[..., ::-1, :, :], axis=-3)[..., ::-1, :, :], 2, axis=-3)
    along = np.repeat(np.cumsum(along[..., ::-1], axis=-1)[..., ::-1], 2, axis=-1)
    w = pose.joint_axis
    turned = (outer @ w[..., :, None])[..., 0]
    full = w @ np.swapaxes(turned, -1, -2) - (w @ np.swapaxes(w, -1, -2)) * along[..., None, :]
    upper = np.triu(full)
    return upper + np.swapaxes(np.triu(full, 1), -1, -2)


def _is_positive_definite(matrices: Array) -> NDArray[np.bool_]:
    """Whether symmetric matrices (B, K, K) are, (B,): all pivots of elimination are positive."""
    left = matrices.copy()
    positive = np.ones(len(left), dtype=bool)
    for k in range(left.shape[-1]):
        pivot = left[:, k, k]
        positive &= pivot > 0.0
        row = left[:, k, k + 1 :] / np.sqrt(np.where(pivot > 0.0, pivot, np.inf))[:, None]
        left[:, k + 1 :, k + 1 :] -= row[:, :, None] * row[:, None, :]
    return positive


def descent_step(hessian: Array, gradient: Array, stable: NDArray[np.bool_]) -> Array:
    """Newton's step where the potential curves up all ways, else along the absolute curvatures.

    Where it curves down the arm would not stay, balanced or not: there the step has a least
    length.
    """
    step = np.empty_like(gradient)
    if stable.any():
        step[stable] = -np.linalg.solve(hessian[stable], gradient[stable, :, None])[..., 0]
    if not stable.all():
        values, vectors = np.linalg.eigh(hessian[~stable])
        curvature = np.maximum(np.abs(values), 1e-6 * np.abs(values).max(-1, keepdims=True))
        along = (np.swapaxes(vectors, -1, -2) @ gradient[~stable][..., None])[..., 0]
        away = np.where(along < 0.0, _LEAST_ESCAPE_RAD, -_LEAST_ESCAPE_RAD)
        newton = -along / curvature
        escaping = (values < 0.0) & (np.abs(newton) < _LEAST_ESCAPE_RAD)
        step[~stable] = (vectors @ np.where(escaping, away, newton)[..., None])[..., 0]
    longest = np.abs(step).max(-1, keepdims=True)
    return step * np.minimum(1.0, LONGEST_TURN_RAD / np.maximum(longest, 1e-300))


def _line_search(
    mechanism: Mechanism, start: _Point, step: Array, rest: Array, arms: Array
) -> tuple[_Point, NDArray[np.bool_]]:
    """Armijo backtracking on the potential, and which samples found a pose to move to.

    A step is too long where it pulls cables taut that the second derivatives took for slack. It is
    cut by Newton's method along the line, from its far end with the cables taut there: cutting
    from the near end instead would stop short of the kink, and so forever. Near the equilibrium,
    where the potential is flat to rounding, full steps pass.
    """
    slope = (step * start.gradient_n_m).sum(-1)
    rounding = ROUNDING * (np.abs(start.potential_j) + 1.0)
    rounding += rounding_m(mechanism) * start.tension_n.sum(-1)
    fraction = np.ones(len(step))
    end = _Point.at(mechanism, start.angles_rad + step, rest, arms)
    while True:
        rise = end.potential_j - start.potential_j
        found = rise <= ARMIJO * fraction * slope + rounding
        again = np.flatnonzero(~found & (fraction > _SHORTEST_STEP))
        if not again.size:
            return end, found
        far, along = _rows(end, again), step[again]
        pulled = (kinematics.interleave(far.span) @ along[..., None])[..., 0]
        curvature = (mechanism.stiffness_n_m * (far.tension_n > 0.0) * pulled**2).sum(-1)
        excess = (far.gradient_n_m * along).sum(-1)
        cut = 1.0 - excess / np.maximum(fraction[again] * curvature, 1e-300)
        fraction[again] *= np.clip(cut, *_CUT)
        angles = start.angles_rad[again] + fraction[again, None] * along
        _replace_rows(end, again, _Point.at(mechanism, angles, rest[again], arms[again]))
