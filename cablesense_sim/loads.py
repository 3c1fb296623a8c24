"""Contact forces: their angle and magnitude, their components, and where on the arm they act."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from cablesense_base import Array, CableSenseError
from cablesense_sim import kinematics
from cablesense_sim.mechanism import Mechanism

_OFF_LINE_M = 0.03  # an arm under load is elsewhere than where it is commanded, by less than this
_AS_NEAR = 3.0
"""A second segment is as near to a line if it is at most so many times as far."""
_AS_NEAR_M = 1e-3
"""Or if it is as close as this."""


class LoadError(CableSenseError):
    """A load that the arm cannot bear: names the segment or the number and what would be valid."""


def normal_force_n(
    mechanism: Mechanism,
    command_rad: ArrayLike,
    segment: ArrayLike,
    angle_deg: ArrayLike,
    magnitude_n: ArrayLike,
) -> Array:
    """Forces (..., N, 3) in base axes of one contact each.

    The force on segment n lies in the plane normal to that segment at the commanded angles (...,
    2N), at `angle_deg` (...) from +z towards +y of its frame. Segment 0 is no contact.

    Raises:
        LoadError: a segment outside 0..N, a negative or non-finite magnitude, a non-finite angle.
    """
    command = np.asarray(command_rad, dtype=float)
    angle = np.asarray(angle_deg, dtype=float)
    magnitude = np.asarray(magnitude_n, dtype=float)
    number, angle, magnitude = np.broadcast_arrays(np.asarray(segment), angle, magnitude)
    count = mechanism.segment_count
    if not np.issubdtype(number.dtype, np.integer) or (number < 0).any() or (number > count).any():
        raise LoadError(f"segment must be a whole number from 0 (no contact) to {count}")
    if not (np.isfinite(angle).all() and np.isfinite(magnitude).all() and (magnitude >= 0).all()):
        raise LoadError("a contact needs a finite angle_deg and a finite magnitude_n from 0 up")
    rotation = kinematics.segment_rotations(mechanism, command)
    theta = np.deg2rad(angle)[..., None, None]
    direction = np.sin(theta) * rotation[..., :, 1] + np.cos(theta) * rotation[..., :, 2]
    pushed = number[..., None] == np.arange(1, count + 1)
    return direction * (pushed * magnitude[..., None])[..., None]


def contact_angle_deg(
    mechanism: Mechanism, command_rad: ArrayLike, segment: ArrayLike, force_base_n: ArrayLike
) -> Array:
    """Angle (...) in [0, 360) of forces (..., 3) in the normal plane of their segment 1..N."""
    y, z = normal_components_n(mechanism, command_rad, segment, force_base_n)
    angle = np.rad2deg(np.arctan2(y, z)) % 360.0
    return np.where(angle < 360.0, angle, 0.0)  # the remainder of -1e-15 rounds up to 360


def normal_components_n(
    mechanism: Mechanism, command_rad: ArrayLike, segment: ArrayLike, force_base_n: ArrayLike
) -> tuple[Array, Array]:
    """The y and z components (...) of base-frame forces (..., 3) in the frame of their segment."""
    rotation = kinematics.segment_rotations(mechanism, np.asarray(command_rad, dtype=float))
    position = np.asarray(segment)[..., None, None, None] - 1
    if (position < 0).any() or (position >= mechanism.segment_count).any():
        raise LoadError(f"segment must be from 1 to {mechanism.segment_count}")
    shape = np.broadcast_shapes(rotation.shape[:-3], position.shape[:-3])
    rotation = np.broadcast_to(rotation, (*shape, *rotation.shape[-3:]))
    axes = np.take_along_axis(rotation, np.broadcast_to(position, (*shape, 1, 1, 1)), axis=-3)
    local = (np.asarray(force_base_n, dtype=float)[..., None, :] @ axes[..., 0, :, :])[..., 0, :]
    return local[..., 1], local[..., 2]


def contact_of_wrench(
    mechanism: Mechanism,
    joint_angles_rad: Array,
    touched_m: Array,
    force_n: Array,
    torque_n_m: Array,
) -> tuple[int, float]:
    """The segment, from 1, and the place from its joint centre, m, where a wrench acts on the arm.

    It is the point of the axis, within `touched_m` (N, 2) of each segment, that is nearest to
    the line of action of a force (3,), base axes, whose torque (3,) is about the base frame's
    origin.

    Raises:
        LoadError: no force, or its line passes the axis too far away, or meets two segments, as
            that of an axial force does.
    """
    magnitude_n = float(np.linalg.norm(force_n))
    if not magnitude_n > 0.0:
        raise LoadError(f"a wrench of force {force_n} N has no line on which it acts")
    pose = kinematics.chain(mechanism, joint_angles_rad)
    usual_m = mechanism.contact_m
    points_m = pose.joint_m + usual_m[:, None] * pose.rotation[..., 0]
    missing = (torque_n_m - np.cross(points_m, force_n)) / magnitude_n
    slope = np.cross(pose.rotation[..., 0], force_n) / magnitude_n
    further_m = (missing * slope).sum(-1) / np.maximum((slope * slope).sum(-1), 1e-12)
    place_m = np.clip(usual_m + further_m, *touched_m.T)
    off_m = np.linalg.norm(missing - (place_m - usual_m)[:, None] * slope, axis=-1)
    nearest = int(np.argmin(off_m))
    on_axis_m = pose.joint_m + place_m[:, None] * pose.rotation[..., 0]
    apart_m = np.linalg.norm(on_axis_m - on_axis_m[nearest], axis=-1)
    as_near = (off_m <= max(_AS_NEAR * off_m[nearest], _AS_NEAR_M)) & (apart_m > _OFF_LINE_M)
    if not off_m[nearest] <= _OFF_LINE_M or as_near.any():
        passes = ", ".join(f"{1e3 * each:.0f}" for each in off_m)
        raise LoadError(
            f"the force acts on a line that passes the axes of the segments {passes} mm away; "
            f"it must meet one, by its torque about the base frame's origin"
        )
    return nearest + 1, float(place_m[nearest])
