"""Static equilibrium: the arm's pose under a command and loads, and the tensions of its cables.

While the actuators hold the cable lengths of the commanded angles c, cable i carries T_i =
max(0, k_i s_i) with s_i = l_i(q) - l_i(c) + T0_i / k_i, and the arm is in equilibrium where the
potential

    V(q) = sum_i k_i max(0, s_i)^2 / 2  -  sum_n A_n · x_n(q)

is least (A_n: weight and loads on segment n's unit axis x_n, `kinematics.load_arms`). The loads
keep their direction in the base frame, so V exists, and slack cables only make it piecewise:
continuously differentiable, twice so between kinks. `equilibrium_search` finds the minimum; slack
cables need no special case. It is compiled, and imported when the first equilibrium is asked for.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablesense_base import Array, CableSenseError
from cablesense_sim import kinematics
from cablesense_sim.mechanism import Mechanism

if TYPE_CHECKING:
    from cablesense_sim.equilibrium_search import Imbalance

RESIDUAL_LIMIT_N_M = 1e-7
"""Largest joint torque left unbalanced in a pose that counts as an equilibrium.

On arms too large and stiff for double precision, what rounding leaves counts instead.
"""
_SEARCHED_SHARE = 0.01
"""Share of this limit at which a search ends, so that one which is repeated gives the same."""

MAX_FORCE_N = 1e6
"""Largest force component that is accepted; a larger one has a wrong unit."""


class EquilibriumError(CableSenseError):
    """No static pose was found: names the case, its command, its loads and the torque left.

    Attributes:
        failed: positions of all cases without a pose, in the batch flattened to one axis; empty
            where the input itself was refused.
    """

    def __init__(self, message: str, failed: ArrayLike = ()) -> None:
        super().__init__(message)
        self.failed = np.asarray(failed, dtype=np.int64)


@dataclass(frozen=True)
class Equilibrium:
    """Poses of equilibrium, batched on the leading axes of the input.

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
    mechanism: Mechanism,
    command_rad: ArrayLike,
    forces_n: ArrayLike | None = None,
    *,
    held_m: ArrayLike | None = None,
    start_rad: ArrayLike | None = None,
) -> Equilibrium:
    """Pose of equilibrium and tensions for commands (..., 2N) and forces (..., N, 3) in base axes.

    `held_m` (..., M) are the cable lengths that the actuators hold, relative to the straight arm;
    by default those that this very mechanism has at the commanded angles. An arm that differs
    from the one that its controller assumes holds the lengths of the latter. `start_rad`
    (..., 2N) is where the search begins, by default at the command.

    Raises:
        EquilibriumError: a shape does not fit, a number is not finite, or no pose balances a case
            to within `RESIDUAL_LIMIT_N_M`.
    """
    from cablesense_sim.equilibrium_search import search_equilibrium, springs_of

    command, forces = _checked(mechanism, command_rad, forces_n)
    leading = command.shape[:-1]
    command = command.reshape(-1, mechanism.joint_count)
    forces = forces.reshape(-1, mechanism.segment_count, 3)
    enough = max(_SEARCHED_SHARE * RESIDUAL_LIMIT_N_M, _rounding_n_m(mechanism))
    if held_m is None:
        slack_m = _spanned_m(mechanism, command)
    else:
        held = np.broadcast_to(np.asarray(held_m, float), (*leading, mechanism.cable_count))
        straight = _spanned_m(mechanism, np.zeros(mechanism.joint_count))
        slack_m = straight + held.reshape(-1, mechanism.cable_count)
    slack_m = slack_m - mechanism.pretension_n / mechanism.stiffness_n_m
    start = command if start_rad is None else np.asarray(start_rad, float).reshape(command.shape)
    arms = kinematics.load_arms(mechanism, forces)
    # contiguous, so that one kind of array is compiled for
    contiguous = (np.array(each, order="C") for each in (slack_m, arms, start))
    springs = springs_of(mechanism)
    rounding_m = _rounding_m(mechanism)
    angles, tensions, residual, iterations = search_equilibrium(
        springs, enough, rounding_m, *contiguous
    )
    _require_equilibrium(mechanism, command, forces, angles, residual)
    return Equilibrium(
        joint_angles_rad=angles.reshape(*leading, mechanism.joint_count),
        tensions_n=tensions.reshape(*leading, mechanism.cable_count),
        residual_n_m=residual.reshape(leading),
        iterations=iterations.reshape(leading).astype(np.int64),
    )


def held_lengths_m(mechanism: Mechanism, command_rad: ArrayLike) -> Array:
    """Cable lengths (..., M) at commanded angles (..., 2N), relative to the straight arm."""
    straight = _spanned_m(mechanism, np.zeros(mechanism.joint_count))
    return _spanned_m(mechanism, np.asarray(command_rad, dtype=float)) - straight


def _spanned_m(mechanism: Mechanism, angles_rad: Array) -> Array:
    """(..., M) sums of the cables' spans at joint angles (..., 2N)."""
    return np.asarray(kinematics.spans(mechanism, angles_rad).length_m.sum(-1))


def checked_command(mechanism: Mechanism, joint_angles_rad: ArrayLike) -> Array:
    """Joint angles (2N,) that the arm can be commanded to.

    Raises:
        EquilibriumError: wrong shape, not finite, or a bend at which guide plates would touch.
    """
    command = np.asarray(joint_angles_rad, dtype=float)
    if command.shape != (mechanism.joint_count,) or not np.isfinite(command).all():
        raise EquilibriumError(
            f"a command is {mechanism.joint_count} finite joint angles in rad, not {command!r}"
        )
    turns = np.abs(command).reshape(-1, 2).max(axis=1)  # no axis goes round to where it was
    bend = np.maximum(kinematics.bend_rad(command), turns)
    limit = mechanism.bend_limit_rad
    if (bend >= limit).any():
        joint = int(np.argmax(bend - limit))
        raise EquilibriumError(
            f"commanded bend of joint {joint + 1} is {np.rad2deg(bend[joint]):.1f} degrees; "
            f"its guide plates touch at {np.rad2deg(limit[joint]):.1f}"
        )
    return command.copy()


def balance_at(
    mechanism: Mechanism, joint_angles_rad: Array, tensions_n: Array, forces_n: Array
) -> Imbalance:
    """The joint torques that poses (..., 2N) leave unbalanced, and their slope; see `Imbalance`.

    They are the first and second derivative of the potential with these tensions (..., M) and
    forces (..., N, 3), slack cables at zero tension.
    """
    from cablesense_sim.equilibrium_search import balanced, plates_of, posed

    arms = kinematics.load_arms(mechanism, forces_n)
    leading = np.broadcast_shapes(
        joint_angles_rad.shape[:-1], tensions_n.shape[:-1], arms.shape[:-2]
    )
    angles, tensions, arms = (
        np.array(np.broadcast_to(values, (*leading, *last)), float).reshape(-1, *last)
        for values, last in (
            (joint_angles_rad, joint_angles_rad.shape[-1:]),
            (tensions_n, tensions_n.shape[-1:]),
            (arms, arms.shape[-2:]),
        )
    )
    pose = posed(plates_of(mechanism, len(angles)), angles)
    stiffness = mechanism.stiffness_n_m * (tensions > 0.0)
    spring = np.tile(np.repeat(mechanism.joint_stiffness_n_m_rad, 2), (len(angles), 1))
    joints = np.ones(mechanism.segment_count)
    along = tensions[..., None] * joints
    by_span = stiffness[..., None, None] * np.ones((joints.size, joints.size))
    imbalance = balanced(pose, along, by_span, arms, spring * angles, spring)
    return type(imbalance)(*(part.reshape(*leading, *part.shape[1:]) for part in imbalance))


def stiffness_matrix_n_m(
    mechanism: Mechanism, joint_angles_rad: Array, tensions_n: Array, forces_n: Array
) -> Array:
    """Second derivative (..., 2N, 2N) of the potential: J' k J where taut, and geometry."""
    return balance_at(mechanism, joint_angles_rad, tensions_n, forces_n).slope_n_m


def _rounding_m(mechanism: Mechanism) -> float:
    """Uncertainty of a cable's stretch in double precision, with some room.

    If plates are wide and close together, a span is a small difference of large squares.
    """
    apart = 2.0 * mechanism.plate_offset_m
    wide = float(np.hypot(mechanism.hole_y_m, mechanism.hole_z_m).max())
    return 4.0 * float(np.finfo(float).eps) * mechanism.segment_count * max(apart, wide**2 / apart)


def _rounding_n_m(mechanism: Mechanism) -> float:
    """The resulting uncertainty of a joint torque."""
    radius = np.hypot(mechanism.hole_y_m, mechanism.hole_z_m)
    return _rounding_m(mechanism) * float((mechanism.stiffness_n_m * radius).max())


def _checked(
    mechanism: Mechanism, command_rad: ArrayLike, forces_n: ArrayLike | None
) -> tuple[Array, Array]:
    """Commands (..., 2N) and forces (..., N, 3) of one batch."""
    joints = mechanism.joint_count
    loads = (mechanism.segment_count, 3)
    command = np.asarray(command_rad, dtype=float)
    forces = np.zeros(loads) if forces_n is None else np.asarray(forces_n, dtype=float)
    if command.shape[-1:] != (joints,) or forces.shape[-2:] != loads:
        raise EquilibriumError(
            f"commands of shape {command.shape} and forces of shape {forces.shape}; their last "
            f"axes must be {joints} joint angles, and {loads}: a base-frame force per segment"
        )
    try:
        leading = np.broadcast_shapes(command.shape[:-1], forces.shape[:-2])
    except ValueError as error:
        raise EquilibriumError(
            f"{command.shape[:-1]} commands do not go with {forces.shape[:-2]} sets of forces"
        ) from error
    largest = np.abs(command).max(initial=0.0), np.abs(forces).max(initial=0.0)
    if not np.isfinite(largest).all():
        raise EquilibriumError("commands and forces must be finite; one holds NaN or infinity")
    if largest[0] > np.pi:
        raise EquilibriumError(
            f"a commanded joint angle of {largest[0]:g} rad is more than half a turn; commands "
            "are in rad, not in degrees"
        )
    if largest[1] > MAX_FORCE_N:
        raise EquilibriumError(
            f"a force component of {largest[1]:g} N is beyond any arm; give at most "
            f"{MAX_FORCE_N:g} N"
        )
    return (
        np.broadcast_to(command, (*leading, joints)),
        np.broadcast_to(forces, (*leading, *loads)),
    )


def _require_equilibrium(
    mechanism: Mechanism, command: Array, forces: Array, angles: Array, residual: Array
) -> None:
    """Require that every case is at rest, at bends at which no guide plates touch."""
    bend = kinematics.bend_rad(angles)
    limit = mechanism.bend_limit_rad
    unbalanced = ~(residual <= max(RESIDUAL_LIMIT_N_M, _rounding_n_m(mechanism)))
    failed = np.flatnonzero(unbalanced | ~(bend < limit).all(-1))
    if not failed.size:
        return
    i = int(failed[0])
    joint = int(np.argmax(bend[i] - limit))
    why = (
        "come to no stable rest"
        if unbalanced[i]
        else f"bend joint {joint + 1} by {np.rad2deg(bend[i, joint]):.1f} degrees, and its guide "
        f"plates touch at {np.rad2deg(limit[joint]):.1f}"
    )
    raise EquilibriumError(
        f"no equilibrium for {failed.size} of {len(command)} cases; case {i}: command "
        f"{np.rad2deg(command[i]).round(2).tolist()} deg, forces {forces[i].round(3).tolist()} N "
        f"{why}; lower the loads or the commanded angles, or raise the stiffness",
        failed,
    )
