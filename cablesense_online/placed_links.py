"""Contacts in the message frames of their links, and what messages state in the axis frames.

Each link has four frames. For the segment of an arm the first two are one, so nothing is moved:

| frame     | origin and axes                               | what is in it                     |
| --------- | --------------------------------------------- | --------------------------------- |
| axis      | on the link's axis, x along it; of a segment  | `Contact`: place, angle, force;   |
|           | at its joint's centre                         | the law and its levers            |
| message   | that of `header.frame_id`: of a segment its   | numbers on topics and in tables   |
|           | axis frame, of a machine that of the body     | of estimates                      |
| commanded | either of these at `FeltMachine.frame_pose`,  | the axes of contacts in both, as  |
|           | mostly the commanded pose                     | consumers know this pose          |
| tf        | the message frame at `joint_states`: set      | drawings of the arm; under a load |
|           | points, or of a simulation the bent pose      | turned against the commanded one  |
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cablesense_base import Array
from cablesense_contact.felt import FeltMachine, LinkFrameOffsets, LinksAtPose
from cablesense_msgs_py.topics import Frames
from cablesense_sim.loads import LoadError
from cablesense_sim.rotations import quaternion_xyzw

_Vector = tuple[float, float, float]
_LEAST_LATERAL = 1e-3
"""Share of a force across a link, below which its torque says nothing of its place."""


def contact_frames(machine: FeltMachine, prefix: str) -> Frames:
    """The frames in which contacts on a machine are stated."""
    names = machine.link_names
    numbered = tuple(f"segment_{number + 1}" for number in range(len(names)))
    return Frames(len(names), prefix, () if names == numbered else names)


class PlacedLinks:
    """Wrenches, points and directions of links, numbered from 1, in their message frames."""

    def __init__(self, axis_frames: LinkFrameOffsets | None) -> None:
        """None where the links' axis frames are their message frames."""
        self._axis_frames = axis_frames
        if axis_frames is not None:
            self._quaternions = [quaternion_xyzw(axes) for axes in axis_frames.axes]

    def wrench(self, number: int, wrench: Sequence[float]) -> Sequence[float]:
        """(6,) force and moment; without a contact, with number 0, as it is."""
        if self._axis_frames is None or not number:
            return wrench
        axes = self._axis_frames.axes[number - 1]
        force = axes @ np.array(wrench[:3])
        arm_m = self._axis_frames.origin_m[number - 1]
        moment = axes @ np.array(wrench[3:]) + np.cross(arm_m, force)
        return [*force.tolist(), *moment.tolist()]

    def point(self, number: int, place_m: float) -> _Vector:
        """A place along a link."""
        if self._axis_frames is None:
            return place_m, 0.0, 0.0
        along = self._axis_frames.axes[number - 1, :, 0]
        x, y, z = (self._axis_frames.origin_m[number - 1] + place_m * along).tolist()
        return x, y, z

    def direction(self, number: int, across: Sequence[float]) -> _Vector:
        """A direction (y, z) across a link."""
        y, z = across
        if self._axis_frames is None:
            return 0.0, y, z
        axes = self._axis_frames.axes[number - 1]
        x, y, z = (axes @ np.array([0.0, y, z])).tolist()
        return x, y, z

    def quaternion(self, number: int) -> Sequence[float]:
        """(4,) x, y, z, w of a link's axis frame."""
        if self._axis_frames is None:
            return 0.0, 0.0, 0.0, 1.0
        return self._quaternions[number - 1]

    def wrench_on_axis(self, number: int, force: Array, torque: Array) -> tuple[Array, Array]:
        """Force and moment (3,) of a message, in the link's axis frame."""
        if self._axis_frames is None or not number:
            return force, torque
        axes = self._axis_frames.axes[number - 1]
        moment = torque - np.cross(self._axis_frames.origin_m[number - 1], force)
        return force @ axes, moment @ axes

    def place_m(self, number: int, point: Array) -> float:
        """Where along its axis a link has a point (3,) of a message."""
        if self._axis_frames is None:
            return float(point[0])
        from_origin = point - self._axis_frames.origin_m[number - 1]
        return float(from_origin @ self._axis_frames.axes[number - 1, :, 0])

    def load_torque(self, number: int, links: LinksAtPose, force: Array, place_m: float) -> Array:
        """(3,) torque of a load, (3,) in base axes, about the origin of the message frame."""
        arm_m = self._origin_m(number, links) + place_m * links.axes[number - 1, :, 0]
        return np.cross(arm_m, force)

    def load_place_m(self, number: int, links: LinksAtPose, force: Array, torque: Array) -> float:
        """Where along a link a load acts, by such a torque: the opposite of `load_torque`.

        With the axis e and the axis frame's origin at o, τ = (o + s e) x f, so
        s = (e x f)·(τ - o x f) / |e x f|².

        Raises:
            LoadError: the force is along the link, so that no torque says where it acts.
        """
        slope = np.cross(links.axes[number - 1, :, 0], force)
        if np.linalg.norm(slope) <= _LEAST_LATERAL * np.linalg.norm(force):
            raise LoadError(
                "a force along a link has no place that a torque could state; leave the torque out"
            )
        along_axis = torque - np.cross(self._origin_m(number, links), force)
        return float(slope @ along_axis / (slope @ slope))

    def _origin_m(self, number: int, links: LinksAtPose) -> Array:
        """(3,) from the origin of the message frame to that of the axis frame, in base axes."""
        if self._axis_frames is None:
            return np.zeros(3)
        in_base = links.axes[number - 1] @ self._axis_frames.axes[number - 1].T
        return np.asarray(in_base @ self._axis_frames.origin_m[number - 1])
