"""Motion of joints relative to their drives, within the gaps that backlash leaves.

It follows from measured motion and the model. A joint lies at that end of its gap at which the
drive gives the torque that the link needs; where that changes its sign, the link moves freely to
the other end.
"""

from __future__ import annotations

import copy
from functools import cached_property

import numpy as np

from cablesense_base import Array
from cablesense_gap.robot import smoothing
from cablesense_gap.robot.model import Robot, inverse_dynamics
from cablesense_gap.robot.motion import Motion

_CACHED = 48
_LEAST_KG_M2 = 1e-9


class BacklashMotion:
    """Of a robot whose motion was measured at the drives."""

    def __init__(self, robot: Robot, motion: Motion) -> None:
        """`motion` is what was measured."""
        self._robot, self._motion = robot, motion
        self._known: dict[tuple[int, float], Array] = {}

    @cached_property
    def _free_acceleration(self) -> tuple[Array, ...]:
        """By trial, accelerations (T, J) of freely moving joints relative to their drives."""
        model = copy.copy(self._robot.model)
        inertia = np.maximum(self._motion.inertia - model.dof_armature, _LEAST_KG_M2)
        model.dof_armature[:], model.dof_damping[:] = 0.0, 0.0
        rate_hz = self._motion.rate_hz
        return tuple(
            -inverse_dynamics(model, path, *smoothing.derivatives(path, rate_hz)) / inertia
            for path in self._motion.paths
        )

    def moved(self, play: Array) -> tuple[Array, Array, Array]:
        """Positions, speeds and accelerations of joints from drives, (ΣT, J), smoothed alike."""
        found = np.zeros((3, sum(len(path) for path in self._motion.paths), len(play)))
        for j in np.flatnonzero(play).tolist():
            key = j, float(play[j])
            if key not in self._known:
                if len(self._known) >= _CACHED:
                    self._known.pop(next(iter(self._known)))
                self._known[key] = self._of_joint(*key)
            found[:, :, j] = self._known[key]
        return found[0], found[1], found[2]

    def _of_joint(self, joint: int, play: float) -> Array:
        motion, found = self._motion, []
        for free in self._free_acceleration:
            gap = _place_in_gap(free[:, joint], 0.5 * play, 1.0 / motion.rate_hz)[:, None]
            smooth = smoothing.smoothed(gap, motion.rate_hz, motion.smoothed_hz)
            moved = smooth, *smoothing.derivatives(smooth, motion.rate_hz)
            found.append(np.hstack(moved).T)
        return np.concatenate(found, 1)


def _place_in_gap(acceleration: Array, reach: float, interval_s: float) -> Array:
    """(T,) positions within ±`reach` of a joint that moves freely with an acceleration (T,)."""
    place, speed, found = float(np.sign(acceleration[0])) * reach, 0.0, []
    for each in acceleration.tolist():
        speed += each * interval_s
        place += speed * interval_s
        if abs(place) >= reach:
            place, speed = (reach if place > 0.0 else -reach), 0.0
        found.append(place)
    return np.array(found)
