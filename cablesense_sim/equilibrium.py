"""Static equilibrium of the arm: where it rests under a command and a set of loads, and with which tensions.

With the actuators holding the cable lengths of the commanded angles c, cable i carries T_i = max(0, k_i s_i) with
s_i = l_i(q) - l_i(c) + T0_i / k_i, and the arm rests where the potential

    V(q) = sum_i k_i max(0, s_i)^2 / 2  -  sum_n A_n · x_n(q)

is least (A_n: weight and loads on segment n's unit axis x_n, `kinematics.load_arms`). The loads keep their direction in
the base frame, so V exists, and slack cables only make it piecewise: continuously differentiable, twice so between
kinks. That suits Newton's method with the exact second derivatives and a line search on V (Nocedal and Wright,
Numerical Optimization, 2006, sections 3.4 and 6.2); slack needs no case of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablesense_msgs_py.errors import CableSenseError
from cablesense_sim import kinematics
from cablesense_sim.mechanism import Mechanism

Array = NDArray[np.float64]

RESIDUAL_LIMIT_N_M = 1e-7
"""Largest joint torque left unbalanced in a pose that counts as an equilibrium."""

MAX_ITERATIONS = 100
_CHUNK = 1024
_ARMIJO = 1e-4
_SHORTEST_STEP = 1e-9
_LONGEST_TURN_RAD = 0.1


class EquilibriumError(CableSenseError):
    """No static pose was found: names the case, its command, its loads and the torque left."""


@dataclass(frozen=True)
class Equilibrium:
    """Resting poses, batched on the leading axes of the input.

    Attributes:
        joint_angles_rad: (..., 2N) true joint angles.
        tensions_n: (..., M) cable tensions, never negative.
        residual_n_m: (...) largest joint torque left unbalanced.
        iterations: (...) Newton steps taken.
    """

    joint_angles_rad: Array
    tensions_n: Array
    residual_n_m: Array
    iterations: NDArray[np.int64]


def solve_equilibrium(
    mechanism: Mechanism, command_rad: ArrayLike, forces_n: ArrayLike | None = None
) -> Equilibrium:
    """Resting pose and tensions for commanded angles (..., 2N) and contact forces (..., N, 3) in base axes.

    Raises:
        EquilibriumError: a shape does not fit, a number is not finite, or no pose balances a case to within
            `RESIDUAL_LIMIT_N_M`.
    """
    command, forces = _checked(mechanism, command_rad, forces_n)
    leading = command.shape[:-1]
    command = command.reshape(-1, mechanism.joint_count)
    forces = forces.reshape(-1, mechanism.segment_count, 3)
    parts = [
        _solve_chunk(mechanism, command[i : i + _CHUNK], forces[i : i + _CHUNK])
        for i in range(0, len(command), _CHUNK)
    ] or [_solve_chunk(mechanism, command, forces)]
    angles, tensions, residual, iterations = (np.concatenate(p) for p in zip(*parts, strict=True))
    _require_rest(mechanism, command, forces, angles, residual)
    return Equilibrium(
        joint_angles_rad=angles.reshape(*leading, mechanism.joint_count),
        tensions_n=tensions.reshape(*leading, mechanism.cable_count),
        residual_n_m=residual.reshape(leading),
        iterations=iterations.reshape(leading),
    )


def stiffness_matrix_n_m(
    mechanism: Mechanism, joint_angles_rad: Array, tensions_n: Array, forces_n: Array
) -> Array:
    """Second derivative (..., 2N, 2N) of the potential at a pose: J' k J of the taut cables, and geometry."""
    span = kinematics.spans(mechanism, joint_angles_rad)
    return _hessian(mechanism, span, joint_angles_rad, tensions_n, forces_n)


def tension_sensitivity(
    mechanism: Mechanism, joint_angles_rad: Array, tensions_n: Array, forces_n: Array
) -> Array:
    """Derivative (..., M, N, 3) of the tensions by the contact forces, at an equilibrium; no unit.

    From the implicit function theorem: dT/df = k J K^-1 B' for taut cables, zero for slack ones, with K the
    stiffness matrix and B the contact Jacobian.
    """
    jacobian = kinematics.cable_jacobian_m(mechanism, joint_angles_rad)
    hessian = stiffness_matrix_n_m(mechanism, joint_angles_rad, tensions_n, forces_n)
    contact = kinematics.contact_jacobians_m(mechanism, joint_angles_rad)
    flat = contact.reshape(*contact.shape[:-3], -1, mechanism.joint_count)
    moved = np.linalg.solve(hessian, np.swapaxes(flat, -1, -2))
    stiffness = mechanism.stiffness_n_m * (tensions_n > 0.0)
    gain = (stiffness[..., None] * jacobian) @ moved
    return gain.reshape(*gain.shape[:-1], mechanism.segment_count, 3)


def _checked(
    mechanism: Mechanism, command_rad: ArrayLike, forces_n: ArrayLike | None
) -> tuple[Array, Array]:
    command = np.asarray(command_rad, dtype=float)
    if command.shape[-1:] != (mechanism.joint_count,):
        raise EquilibriumError(
            f"command has shape {command.shape}; its last axis must be {mechanism.joint_count} joint angles"
        )
    expected = (*command.shape[:-1], mechanism.segment_count, 3)
    forces = np.zeros(expected) if forces_n is None else np.asarray(forces_n, dtype=float)
    if forces.shape[-2:] != expected[-2:]:
        raise EquilibriumError(
            f"forces have shape {forces.shape}; the last axes must be {expected[-2:]}, one base-frame "
            "force per segment"
        )
    try:
        leading = np.broadcast_shapes(command.shape[:-1], forces.shape[:-2])
    except ValueError as error:
        raise EquilibriumError(
            f"{command.shape[:-1]} commands do not go with {forces.shape[:-2]} sets of forces"
        ) from error
    command = np.broadcast_to(command, (*leading, command.shape[-1]))
    forces = np.broadcast_to(forces, (*leading, *expected[-2:]))
    if not (np.isfinite(command).all() and np.isfinite(forces).all()):
        raise EquilibriumError("commands and forces must be finite; one holds NaN or infinity")
    return command, forces


def _require_rest(
    mechanism: Mechanism, command: Array, forces: Array, angles: Array, residual: Array
) -> None:
    """Every case at rest, and none bent so far that guide plates would have met before."""
    bend, limit = kinematics.bend_rad(angles), mechanism.bend_limit_rad
    unbalanced = ~(residual <= RESIDUAL_LIMIT_N_M)
    failed = np.flatnonzero(unbalanced | ~(bend < limit).all(-1))
    if not failed.size:
        return
    i = int(failed[0])
    joint = int(np.argmax(bend[i] - limit))
    why = (
        f"leave {residual[i]:.3g} N·m (at most {RESIDUAL_LIMIT_N_M:g})"
        if unbalanced[i]
        else f"bend joint {joint + 1} by {np.rad2deg(bend[i, joint]):.1f} degrees, and its guide plates "
        f"touch at {np.rad2deg(limit[joint]):.1f}"
    )
    raise EquilibriumError(
        f"no equilibrium for {failed.size} of {len(command)} cases; case {i}: command "
        f"{np.rad2deg(command[i]).round(2).tolist()} deg, forces {forces[i].round(3).tolist()} N {why}; "
        "lower the loads or the commanded angles, or raise the stiffness"
    )


def _solve_chunk(
    mechanism: Mechanism, command: Array, forces: Array
) -> tuple[Array, Array, Array, NDArray[np.int64]]:
    """Newton with line search on a batch; samples leave as they converge."""
    stiffness = mechanism.stiffness_n_m
    rest = (
        kinematics.spans(mechanism, command).length_m.sum(-1) - mechanism.pretension_n / stiffness
    )
    arms = kinematics.load_arms(mechanism, forces)
    angles = command.copy()
    residual = np.full(len(command), np.inf)
    iterations = np.zeros(len(command), dtype=np.int64)
    live = np.arange(len(command))
    for iteration in range(MAX_ITERATIONS + 1):
        q = angles[live]
        span = kinematics.spans(mechanism, q)
        stretch = span.length_m.sum(-1) - rest[live]
        tension = np.maximum(stiffness * stretch, 0.0)
        gradient = _gradient(mechanism, span, q, tension, forces[live])
        residual[live] = np.abs(gradient).max(axis=-1)
        iterations[live] = iteration
        going = ~(residual[live] <= 0.01 * RESIDUAL_LIMIT_N_M)
        if iteration == MAX_ITERATIONS or not going.any():
            break
        live, q, gradient, tension = live[going], q[going], gradient[going], tension[going]
        span = kinematics.Spans(*(part[going] for part in span))
        hessian = _hessian(mechanism, span, q, tension, forces[live])
        step = _descent_step(hessian, gradient)
        angles[live], moved = _line_search(
            mechanism, q, step, gradient, rest[live], arms[live]
        )
        if not moved.any():
            break
        live = live[moved]
    stretch = kinematics.spans(mechanism, angles).length_m.sum(-1) - rest
    return angles, np.maximum(stiffness * stretch, 0.0), residual, iterations


def _gradient(
    mechanism: Mechanism, span: kinematics.Spans, q: Array, tension: Array, forces: Array
) -> Array:
    by_pitch = np.einsum("bij,bi->bj", span.by_pitch, tension)
    by_yaw = np.einsum("bij,bi->bj", span.by_yaw, tension)
    cables = np.stack([by_pitch, by_yaw], axis=-1).reshape(q.shape)
    return cables - kinematics.load_torques_n_m(mechanism, q, forces)


def _hessian(
    mechanism: Mechanism, span: kinematics.Spans, q: Array, tension: Array, forces: Array
) -> Array:
    jacobian = kinematics.interleave(span)
    taut = mechanism.stiffness_n_m * (tension > 0.0)
    hessian = np.swapaxes(jacobian, -1, -2) @ (taut[..., None] * jacobian)
    for row, column, second in (
        (0, 0, span.by_pitch_pitch),
        (0, 1, span.by_pitch_yaw),
        (1, 0, span.by_pitch_yaw),
        (1, 1, span.by_yaw_yaw),
    ):
        block = (second * tension[..., :, None]).sum(-2)
        joints = np.arange(mechanism.segment_count)
        hessian[..., 2 * joints + row, 2 * joints + column] += block
    return hessian - _load_hessian(mechanism, q, forces)


def _load_hessian(mechanism: Mechanism, q: Array, forces: Array) -> Array:
    """Second derivative of `sum_n A_n · x_n`: axis k before axis l turns x_n by w_k x (w_l x x_n)."""
    pose = kinematics.chain(mechanism, q)
    x, arms = pose.rotation[..., 0], kinematics.load_arms(mechanism, forces)
    outer = x[..., :, None] * arms[..., None, :]
    along = (x * arms).sum(-1)
    outer = np.repeat(np.cumsum(outer[..., ::-1, :, :], axis=-3)[..., ::-1, :, :], 2, axis=-3)
    along = np.repeat(np.cumsum(along[..., ::-1], axis=-1)[..., ::-1], 2, axis=-1)
    w = pose.joint_axis
    turned = (outer @ w[..., :, None])[..., 0]
    full = w @ np.swapaxes(turned, -1, -2) - (w @ np.swapaxes(w, -1, -2)) * along[..., None, :]
    upper = np.triu(full)
    return upper + np.swapaxes(np.triu(full, 1), -1, -2)


def _descent_step(hessian: Array, gradient: Array) -> Array:
    """The Newton step where it descends, else one along the absolute curvatures."""
    try:
        step = -np.linalg.solve(hessian, gradient[..., None])[..., 0]
    except np.linalg.LinAlgError:
        step = np.full_like(gradient, np.nan)
    slope = (step * gradient).sum(-1)
    uphill = ~(slope < 0.0)
    if uphill.any():
        values, vectors = np.linalg.eigh(hessian[uphill])
        curvature = np.maximum(np.abs(values), 1e-6 * np.abs(values).max(-1, keepdims=True))
        along = (np.swapaxes(vectors, -1, -2) @ gradient[uphill][..., None])[..., 0]
        step[uphill] = -(vectors @ (along / curvature)[..., None])[..., 0]
    longest = np.abs(step).max(-1, keepdims=True)
    return step * np.minimum(1.0, _LONGEST_TURN_RAD / np.maximum(longest, 1e-300))


def _line_search(
    mechanism: Mechanism, q: Array, step: Array, gradient: Array, rest: Array, arms: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Armijo backtracking on the potential; near the bottom, where V is flat to rounding, full steps pass."""
    start = _potential(mechanism, q, rest, arms)
    slope = (step * gradient).sum(-1)
    rounding = 1e-13 * (np.abs(start) + 1.0)
    fraction = np.ones(len(q))
    found = np.zeros(len(q), dtype=bool)
    best = q.copy()
    open_ = np.arange(len(q))
    while open_.size and fraction[open_[0]] > _SHORTEST_STEP:
        trial = q[open_] + fraction[open_, None] * step[open_]
        value = _potential(mechanism, trial, rest[open_], arms[open_])
        allowed = start[open_] + _ARMIJO * fraction[open_] * slope[open_] + rounding[open_]
        good = value <= allowed
        best[open_[good]] = trial[good]
        found[open_[good]] = True
        open_ = open_[~good]
        fraction[open_] *= 0.5
    return best, found


def _potential(mechanism: Mechanism, q: Array, rest: Array, arms: Array) -> Array:
    stretch = np.maximum(kinematics.spans(mechanism, q).length_m.sum(-1) - rest, 0.0)
    x = kinematics.chain(mechanism, q).rotation[..., 0]
    return 0.5 * (mechanism.stiffness_n_m * stretch**2).sum(-1) - (arms * x).sum((-2, -1))
