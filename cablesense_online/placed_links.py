"""Contacts in the frames that messages name, where a link's own frame is another one.

A contact is stated in a frame on the axis of its link, with x along it. An arm's segments have
such frames. The bodies of a MuJoCo model have frames of their own: what is stated is moved there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cablesense_contact.felt import LinkFrames
from cablesense_sim.rotations import quaternion_xyzw

_Vector = tuple[float, float, float]


class PlacedLinks:
    """Wrenches, points and directions of links, numbered from 1, in the frames of messages."""

    def __init__(self, frames: LinkFrames | None) -> None:
        """None where the links' frames are those of messages."""
        self._frames = frames
        if frames is not None:
            self._quaternions = [quaternion_xyzw(axes) for axes in frames.axes]

    def wrench(self, number: int, wrench: Sequence[float]) -> Sequence[float]:
        """(6,) force and moment; without a contact, with number 0, as it is."""
        if self._frames is None or not number:
            return wrench
        axes = self._frames.axes[number - 1]
        force = axes @ np.array(wrench[:3])
        moment = axes @ np.array(wrench[3:]) + np.cross(self._frames.origin_m[number - 1], force)
        return [*force.tolist(), *moment.tolist()]

    def point(self, number: int, place_m: float) -> _Vector:
        """A place along a link."""
        if self._frames is None:
            return place_m, 0.0, 0.0
        along = self._frames.axes[number - 1, :, 0]
        x, y, z = (self._frames.origin_m[number - 1] + place_m * along).tolist()
        return x, y, z

    def direction(self, number: int, across: Sequence[float]) -> _Vector:
        """A direction (y, z) across a link."""
        y, z = across
        if self._frames is None:
            return 0.0, y, z
        axes = self._frames.axes[number - 1]
        x, y, z = (axes @ np.array([0.0, y, z])).tolist()
        return x, y, z

    def quaternion(self, number: int) -> Sequence[float]:
        """(4,) x, y, z, w of a link's frame."""
        if self._frames is None:
            return 0.0, 0.0, 0.0, 1.0
        return self._quaternions[number - 1]
