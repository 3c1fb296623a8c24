"""Place and force of one or two contacts anywhere on an arm, from its tensions, by statics alone.

A force f acts on the axis of segment n, at the distance s from the segment's joint centre. It
makes the joint torques

    tau = (A_n + s B_n)' f,

A_n is the derivative of the joint centre by the joint angles, and B_n that of the segment's axis.
tau follows from the tensions at the true pose, which the taut cables' stretches determine. For
every s the force is then a linear least-squares fit (the profile), and one dimension is left.

All components of the force are unknown. The axial one has a normal prior: it widens the intervals
of the others in poses that do not show it. The prior of place and lateral force is uniform over
the reach of all segments, over directions, and over magnitudes up to the largest. It matters only
where the tensions do not determine a number: on segment 1 they show the moment about joint 1, and
place and force share it.

A surface is touched at a radius r, where an axial force f_x adds the moment r f_x. A straight arm
cannot distinguish it from a contact that is r f_x / f further along; friction bounds the ratio.

Posteriors of a location with all components of the force unknown: Manuelli and Tedrake, Localizing
External Contact Using Proprioceptive Sensors, IROS 2016, who draw particles instead.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablesense_base import Array
from cablesense_sim import kinematics
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import (
    balance_at,
    held_lengths_m,
    solve_equilibrium,
    stiffness_matrix_n_m,
)
from cablesense_sim.mechanism import Mechanism

LARGEST_N = 200.0
"""Lateral force up to which contacts are expected: a person's firm push."""

AXIAL_STD_N = 100.0
"""Prior standard deviation of the axial force on the axis: half the largest lateral force."""

_KNOWN_N, _KNOWN_SHARE = 1.0, 0.2
"""A force is known if half of its 95 % interval is below one of these: in N, or a share of it."""

_SLACK_WEIGHT, _POSE_SLACK_WEIGHT = 1e-3, 1e-5
"""Variance of a slack cable's tension over that of a taut one, and the weight of its length in the
fit of the pose. The weight is nonzero, so that an arm with many slack cables still has a pose, and
so small that a cable that lacks a hundred newtons does not bend it."""
_SLACK_BELOW_STD = 4.0
_POSE_STEPS = 4  # each step squares the error of the pose, which is below 0.1 rad


class Surface(NamedTuple):
    """The surface of the arm, where it is touched with friction.

    Attributes:
        radius_m: from the axis.
        friction: Coulomb coefficient, the prior standard deviation of axial over lateral force.
    """

    radius_m: float
    friction: float


def touched_at(arm: Arm) -> tuple[Array, Surface | None]:
    """The reach (N, 2) of an arm file, m, and its surface if that has friction."""
    touch, mechanism = arm.touch, mechanism_of(arm)
    reach = reach_m(mechanism)
    if touch.reach_m is not None:
        reach[:] = touch.reach_m
    stated = touch.friction and touch.radius_m is not None
    return reach, Surface(touch.radius_m or 0.0, touch.friction) if stated else None


def reach_m(mechanism: Mechanism) -> Array:
    """(N, 2) places on each segment where it can be touched, from its joint centre, m.

    They go from the guide plate after the joint to the next joint centre.
    """
    length = mechanism.segment_length_m
    return np.stack([np.full(len(length), mechanism.plate_offset_m), length], axis=1)


class Prior(NamedTuple):
    """The knowledge of a contact before the tensions, as compiled code takes it."""

    reach_m: Array  # (N, 2) places on each segment
    radius_m: float  # of the surface; negative where contacts act on the axis
    friction: float


class TorqueBalance(NamedTuple):
    """The joint torques of the environment on B samples, and those that contacts can make.

    Attributes:
        torque_n_m: (B, 2N).
        precision: (B, 2N, 2N) inverse covariance of the torques.
        by_force_m: (B, N, 3, 2N) torques by a force at the joint centre of each segment, along the
            axes that the segment has at the commanded angles.
        by_place: (B, N, 3, 2N) their derivative by the distance from the joint centre.
        by_twist: (B, N, 2N) torques of a unit moment about the axis of each segment.
    """

    torque_n_m: Array
    precision: Array
    by_force_m: Array
    by_place: Array
    by_twist: Array


def torque_balance(
    mechanism: Mechanism, command_rad: ArrayLike, difference_n: Array, variance_n2: float
) -> TorqueBalance:
    """The balance of tension differences (B, M) against the unloaded arm at commands (B, 2N).

    `variance_n2` is that of one difference.

    Raises:
        EquilibriumError: the unloaded arm has no equilibrium at a command.
    """
    command = np.asarray(command_rad, dtype=float)
    tension_n = solve_equilibrium(mechanism, command).tensions_n + difference_n
    taut = tension_n > _SLACK_BELOW_STD * variance_n2**0.5
    tension_n = np.where(taut, tension_n, 0.0)
    weight = np.where(taut, 1.0, _POSE_SLACK_WEIGHT)[:, None]
    stretch_m = (tension_n - mechanism.pretension_n) / mechanism.stiffness_n_m
    held_m, angles = held_lengths_m(mechanism, command), command
    for _ in range(_POSE_STEPS):
        jacobian_t = np.swapaxes(kinematics.cable_jacobian_m(mechanism, angles), 1, 2)
        missing_m = stretch_m - (held_lengths_m(mechanism, angles) - held_m)
        # a slack cable may hang as loosely as the pose leaves it
        missing_m = np.where(taut, missing_m, np.minimum(missing_m, 0.0))
        gram = (jacobian_t * weight) @ np.swapaxes(jacobian_t, 1, 2)
        angles = (
            angles + np.linalg.solve(gram, (jacobian_t * weight) @ missing_m[..., None])[..., 0]
        )
    jacobian_t = np.swapaxes(kinematics.cable_jacobian_m(mechanism, angles), 1, 2)
    weight = np.where(taut, 1.0, _SLACK_WEIGHT)[:, None]
    covariance = variance_n2 * (jacobian_t * weight) @ np.swapaxes(jacobian_t, 1, 2)
    unloaded = np.zeros((mechanism.segment_count, 3))
    axes = kinematics.segment_rotations(mechanism, command)
    at_joint, slope = kinematics.contact_torques(mechanism, angles, axes)
    return TorqueBalance(
        balance_at(mechanism, angles, tension_n, unloaded).torque_n_m,
        np.asarray(np.linalg.inv(covariance)),
        at_joint,
        slope,
        twist_torques(mechanism, angles),
    )


def twist_torques(mechanism: Mechanism, angles_rad: Array) -> Array:
    """Joint torques (B, N, 2N) of unit moments about the segments' axes at angles (B, 2N)."""
    pose = kinematics.chain(mechanism, angles_rad)
    joints, segments = np.arange(mechanism.joint_count), np.arange(mechanism.segment_count)
    moves = joints // 2 <= segments[:, None]
    return np.asarray(moves * (pose.rotation[..., 0] @ np.swapaxes(pose.joint_axis, -1, -2)))


class Location(NamedTuple):
    """The posterior of one contact on each of B samples.

    Place, force and moment are those of a contact on the segment that is the most probable one
    to be touched. Next to a joint that can be either of two segments: the region covers both.

    Attributes:
        probability: (B, N + 1) of no contact, and of a contact on each segment.
        segment: (B,) the most probable, from 1 on; 0 for none.
        place_m: (B,) mean distance from the segment's joint centre.
        place_ci95_m: (B, 2) interval of it.
        region_segment, region_m: (B, 2) ends of the interval of the place over all segments: each
            a segment, from 1 on, and the distance from its joint centre.
        force_n: (B, 3) mean force, along the axes of the segment at the commanded angles.
        covariance: (B, 4, 4) of place, m, and force, N.
        magnitude_ci95_n: (B, 2) interval of the lateral force.
        moment_n_m: (B, 2) mean moment about the joint centre, around y and z, with that of the
            axial force at the surface.
        moment_std_n_m: (B, 2) standard deviations.
        log_evidence: (B,) of a contact on any segment against none.
        chi2: (B,) misfit of the best place; 2N - 4 degrees of freedom where all is determined.
    """

    probability: Array
    segment: NDArray[np.int64]
    place_m: Array
    place_ci95_m: Array
    region_segment: NDArray[np.int64]
    region_m: Array
    force_n: Array
    covariance: Array
    magnitude_ci95_n: Array
    moment_n_m: Array
    moment_std_n_m: Array
    log_evidence: Array
    chi2: Array

    @property
    def force_std_n(self) -> Array:
        """(B, 3) standard deviations of the force."""
        return np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2)[:, 1:])

    @property
    def force_known(self) -> NDArray[np.bool_]:
        """(B,) whether the tensions determine the lateral force.

        If not, the moment about the joint is the answer, as nearly always on segment 1.
        """
        low_n, high_n = self.magnitude_ci95_n.T
        return is_known(high_n - low_n, np.hypot(self.force_n[:, 1], self.force_n[:, 2]))


class ContactPair(NamedTuple):
    """The two contacts that are most probable on each of B samples.

    Attributes:
        segments: (B, 2) from 1 on, in ascending order.
        place_m, place_std_m: (B, 2) distances from the segments' joint centres.
        force_n, force_std_n: (B, 2, 3) along the axes of the segments at the command.
        log_evidence: (B,) against no contact, with the prior of `locate`; compare it with
            `Location.log_evidence`.
        chi2: (B,) misfit, with 2N - 8 degrees of freedom where all is determined.
    """

    segments: NDArray[np.int64]
    place_m: Array
    place_std_m: Array
    force_n: Array
    force_std_n: Array
    log_evidence: Array
    chi2: Array


def is_known(width_n: Any, size_n: Any) -> Any:
    """Whether forces of these sizes, with 95 % intervals of these widths, are known."""
    return (width_n <= 2.0 * _KNOWN_N) | (width_n <= 2.0 * _KNOWN_SHARE * size_n)


def locate(balance: TorqueBalance, reach: Array, surface: Surface | None = None) -> Location:
    """The posterior of a single contact from the balance of B samples, within a reach (N, 2), m.

    Contacts act on the axis if no `surface` is given. No contact is as probable as a contact
    before the tensions are known.
    """
    from cablesense_sim.contact_posterior import locate_each, unfilled

    found = unfilled(*balance.by_place.shape[:2])
    locate_each(*compiled_input(balance, reach, surface), found)
    return found


def locate_two(
    balance: TorqueBalance, reach: Array, surface: Surface | None = None
) -> ContactPair:
    """The two contacts from the balance of B samples, within a reach (N, 2), m.

    The fit is a profile over both places. 2N torques determine four numbers of each contact on an
    arm of four segments, where the pose shows the axial forces and no contact is on segment 1.
    Evidence by Laplace's approximation compares pairs of segments with one another and with a
    single contact (MacKay, Information Theory, Inference, and Learning Algorithms, 2003, ch. 28).
    Contacts act on the axis if no `surface` is given; two are on different segments.
    """
    from cablesense_sim.contact_pair_fit import fit_each

    return fit_each(*compiled_input(balance, reach, surface))


def compiled_input(
    balance: TorqueBalance, reach: Array, surface: Surface | None
) -> tuple[TorqueBalance, Prior]:
    """A balance and the prior, as compiled code takes them."""
    prior = Prior(np.ascontiguousarray(reach), *(surface or (-1.0, 0.0)))
    return TorqueBalance(*map(np.ascontiguousarray, balance)), prior


def contact_information(
    mechanism: Mechanism,
    command_rad: ArrayLike,
    segment: NDArray[np.int64],
    place_m: Array,
    force_n: Array,
    variance_n2: float,
) -> Array:
    """Fisher information (B, 4, 4) that tensions have of (f_x, f_y, f_z, place) of contacts.

    Commands are (B, 2N), segments (B,) from 1 on, places (B,) and forces (B, 3) along the axes of
    the segment at the commanded angles; `variance_n2` is that of one tension difference. Its
    inverse is the Cramér-Rao bound of unbiased estimates (Kay, Fundamentals of Statistical Signal
    Processing, vol. I, 1993). The information of what a pose does not show is zero.

    Raises:
        EquilibriumError: the arm has no equilibrium under one of the contacts.
    """
    command = np.asarray(command_rad, dtype=float)
    elastic_n, gain = contact_response(
        mechanism, command, segment[:, None], place_m[:, None], force_n[:, None]
    )
    gain = gain * (elastic_n > 0.0)[..., None]
    return np.asarray(np.swapaxes(gain, 1, 2) @ gain / variance_n2)


def contact_response(
    mechanism: Mechanism,
    command_rad: Array,
    segments: NDArray[np.int64],
    places_m: Array,
    forces_n: Array,
    held_m: Array | None = None,
) -> tuple[Array, Array]:
    """Tensions under K contacts each, and their derivative by the contacts' numbers.

    Commands are (B, 2N), segments (B, K) from 1 on and different, places (B, K). Forces (B, K, 3)
    are along the axes of the segments at the commanded angles; `solve_equilibrium` describes the
    held lengths. Tensions are (B, M), negative where a slack cable lacks length; the derivative
    (B, M, 4K) by (f_x, f_y, f_z, place) of each is that of a cable if it is taut.

    Raises:
        EquilibriumError: the arm has no equilibrium under the contacts of a sample.
    """
    rows = np.arange(len(segments))[:, None]
    n, axes = segments - 1, kinematics.segment_rotations(mechanism, command_rad)
    at_m = np.tile(mechanism.contact_m, (len(n), 1))
    at_m[rows, n] = places_m
    forces = np.zeros((len(n), mechanism.segment_count, 3))
    forces[rows, n] = (axes[rows, n] @ forces_n[..., None])[..., 0]
    touched = replace(mechanism, contact_m=at_m)
    rest = solve_equilibrium(touched, command_rad, forces, held_m=held_m)
    angles = rest.joint_angles_rad
    at_joint, slope = (
        each[rows, n] for each in kinematics.contact_torques(mechanism, angles, axes)
    )
    by_force = at_joint + places_m[..., None, None] * slope
    by_place = forces_n[:, :, None] @ slope
    columns = np.concatenate([by_force, by_place], axis=2)
    columns = columns.reshape(len(n), -1, mechanism.joint_count)
    hessian = stiffness_matrix_n_m(touched, angles, rest.tensions_n, forces)
    moved = np.linalg.solve(hessian, np.swapaxes(columns, 1, 2))
    jacobian = kinematics.cable_jacobian_m(mechanism, angles)
    if held_m is None:
        held_m = held_lengths_m(mechanism, command_rad)
    stretch_m = held_lengths_m(mechanism, angles) - held_m
    elastic_n = mechanism.pretension_n + mechanism.stiffness_n_m * stretch_m
    return elastic_n, np.asarray(mechanism.stiffness_n_m[:, None] * (jacobian @ moved))
