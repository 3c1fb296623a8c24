"""The arm's numbers as arrays: what the MuJoCo model and the statics are both built from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array

LEAST_PRETENSION_N = 0.1
"""Of a cable whose pretension an effect or a tolerance lowers: a cable never pushes."""
LEAST_CABLE_SHARE = 1e-3
"""Share of the compliance of cable and actuator in series that the cable alone has at least: the
actuator keeps the one that is stated."""
_LEAST_RUN = 0.1
"""Compliant length before the base plate, at least, in offsets of a guide plate."""


@dataclass(frozen=True)
class Mechanism:
    """N segments on universal joints, and M cables through guide plates around each joint.

    Shapes are those of one mechanism. In two places arrays have one axis more in front:

    - `contact_m` may be (R, N), where loads act in each of R rows: so the statics take it
      (`solve_equilibrium`, `EquilibriumResponse`, `contact_information`), and what else is by
      contact points does not (`kinematics.contact_points_m`).
    - `stack` gives those that stand in `_STACKED` an axis P, one entry for each of P mechanisms,
      for the quasi-statics of several arms at once.

    Attributes:
        gravity_m_s2: (3,) base frame.
        segment_length_m: (N,) joint centre to joint centre.
        mass_kg: (N,) of each segment.
        centre_of_mass_m: (N,) from the segment's joint centre, on its axis.
        contact_m: (N,) from the segment's joint centre, on its axis: where loads act.
        plate_offset_m: guide plates sit this far before and after each joint centre.
        cable_segment: (M,) 1-based number of the segment that each cable ends on.
        hole_y_m, hole_z_m: (M,) a cable's hole in the plate of the base, in its frame.
        segment_hole_y_m, segment_hole_z_m: (M, N) in the plates that segment n carries, likewise.
        stiffness_n_m: (M,) cable and actuator in series, from command to anchor.
        cable_stiffness_n_m: (M,) of the cable alone, stiffer than the two in series.
        actuator_stiffness_n_m: of each actuator, may be infinite.
        pretension_n: (M,) with the arm straight and weightless.
        run_m: straight run from actuator to base plate.
        joint_damping_n_m_s: of each joint axis, for dynamics.
        joint_stiffness_n_m_rad: (N,) of a spring in each joint axis that is at rest straight.
        relative_friction: (M,) of a cable at its guides, relative to the value stated for all; one
            each.
    """

    gravity_m_s2: Array
    segment_length_m: Array
    mass_kg: Array
    centre_of_mass_m: Array
    contact_m: Array
    plate_offset_m: float
    cable_segment: NDArray[np.int64]
    hole_y_m: Array
    hole_z_m: Array
    segment_hole_y_m: Array
    segment_hole_z_m: Array
    stiffness_n_m: Array
    cable_stiffness_n_m: Array
    actuator_stiffness_n_m: float
    pretension_n: Array
    run_m: float
    joint_damping_n_m_s: float
    joint_stiffness_n_m_rad: Array
    relative_friction: Array

    @property
    def segment_count(self) -> int:
        """Number of segments N."""
        return len(self.segment_length_m)

    @property
    def cable_count(self) -> int:
        """Number of cables M."""
        return len(self.cable_segment)

    @property
    def joint_count(self) -> int:
        """Number of joint angles 2N."""
        return 2 * self.segment_count

    @property
    def passes_joint(self) -> NDArray[np.bool_]:
        """(M, N): whether a cable passes a joint, which it does up to its own segment's."""
        joints = np.arange(1, self.segment_count + 1)
        return self.cable_segment[:, None] >= joints[None, :]

    @property
    def bend_limit_rad(self) -> Array:
        """(N,) bend at which the guide plates around each joint touch at the outermost hole."""
        before, after = self.plate_holes_m
        radius = np.maximum(np.hypot(*before), np.hypot(*after))
        outermost = np.where(self.passes_joint, radius, 0.0).max(axis=-2)
        return 2.0 * np.arctan2(self.plate_offset_m, outermost)

    @property
    def plate_holes_m(self) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """Holes (y, z) in the plates before and after each joint, each (M, N)."""
        y = self.segment_hole_y_m
        z = self.segment_hole_z_m
        before_y = np.concatenate([self.hole_y_m[..., None], y[..., :-1]], axis=-1)
        before_z = np.concatenate([self.hole_z_m[..., None], z[..., :-1]], axis=-1)
        return (before_y, before_z), (y, z)

    @property
    def joint_position_straight_m(self) -> Array:
        """(N,) x of each joint centre with the arm straight; joint 1 is a plate offset ahead."""
        return self.plate_offset_m + np.concatenate([[0.0], np.cumsum(self.segment_length_m)[:-1]])

    @property
    def straight_length_m(self) -> Array:
        """(M,) length of each cable from its actuator to its anchor with the arm straight."""
        joint_m = self.joint_position_straight_m[self.cable_segment - 1]
        return self.run_m + joint_m + self.plate_offset_m

    @property
    def piece_length_m(self) -> Array:
        """(M, 2N) straight lengths of each cable's pieces between the guides that hold it.

        They are the run to the base plate, and in turn a span across a joint and what lies inside
        the segment behind it; zero beyond the end of the cable. A run without length gives a
        little too.
        """
        inside = self.segment_length_m - 2.0 * self.plate_offset_m
        joints = np.arange(1, self.segment_count)
        pieces = np.zeros((self.cable_count, 2 * self.segment_count))
        pieces[:, 0] = np.maximum(self.run_m, _LEAST_RUN * self.plate_offset_m)
        pieces[:, 1::2] = 2.0 * self.plate_offset_m * self.passes_joint
        pieces[:, 2::2] = np.where(self.cable_segment[:, None] > joints, inside[:-1], 0.0)
        return pieces


_STACKED = (
    "gravity_m_s2",
    "mass_kg",
    "centre_of_mass_m",
    "contact_m",
    "hole_y_m",
    "hole_z_m",
    "segment_hole_y_m",
    "segment_hole_z_m",
    "stiffness_n_m",
    "pretension_n",
    "joint_stiffness_n_m_rad",
    "relative_friction",
)


def stack(mechanisms: Sequence[Mechanism]) -> Mechanism:
    """Mechanisms of one kind as one whose arrays have a leading axis P."""
    fields: dict[str, Any] = {
        name: np.stack([getattr(m, name) for m in mechanisms]) for name in _STACKED
    }
    return replace(mechanisms[0], **fields)


Numbers = NDArray[np.floating[Any]]


def with_cables_moved(mechanism: Mechanism, outward_m: Numbers, turned_rad: Numbers) -> Mechanism:
    """Every hole of a cable further out and turned from +z towards +y, each (M,)."""
    y, z = _moved_m(mechanism.hole_y_m, mechanism.hole_z_m, outward_m, turned_rad)
    moved = replace(mechanism, hole_y_m=y, hole_z_m=z)
    return with_plates_moved(moved, outward_m[:, None], turned_rad[:, None])


def with_plates_moved(mechanism: Mechanism, outward_m: Numbers, turned_rad: Numbers) -> Mechanism:
    """Every hole in the plates that a segment carries further out and turned, each (N,)."""
    y = mechanism.segment_hole_y_m
    z = mechanism.segment_hole_z_m
    y, z = _moved_m(y, z, outward_m, turned_rad)
    return replace(mechanism, segment_hole_y_m=y, segment_hole_z_m=z)


def _moved_m(y: Array, z: Array, outward_m: Numbers, turned_rad: Numbers) -> tuple[Array, Array]:
    radius = np.hypot(y, z) + outward_m
    angle = np.arctan2(y, z) + turned_rad
    return np.asarray(radius * np.sin(angle), float), np.asarray(radius * np.cos(angle), float)
