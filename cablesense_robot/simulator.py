"""A robot as the diagnosis simulates it: a `Simulator` of the torques that a motion needs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cablesense_base import Array
from cablesense_gap.simulator import Assignment
from cablesense_robot.catalogue import candidate, changed, known_effects
from cablesense_robot.inverse import InverseDynamics
from cablesense_robot.model import Robot, RobotError
from cablesense_robot.motion import Motion


class RobotSimulator:
    """Torques of those joints that have one, each in units of its own floor.

    Where a joint is at rest, readings and predictions are zero alike; units are such that noise
    alone has a root mean square of one over all rows.

    Attributes: see `Simulator`, and
        channels: (C,) numbers of the joints whose torque is compared.
        readings: (R, C) as measured.
        unit: (C,) of each channel, N·m or N.
    """

    floor = 1.0

    def __init__(self, robot: Robot, motion: Motion, listed: Assignment) -> None:
        """`motion` is what was measured, `listed` are effects that the nominal robot has."""
        self.robot, self.motion, self._listed = robot, motion, dict(listed)
        effects = known_effects().values()
        offered = [(e, candidate(e, robot, motion.scale)) for e in effects]
        self.candidates = tuple(c for e, c in offered if not e.tolerance and c.places)
        self.tolerances = tuple(c for e, c in offered if e.tolerance)
        self.channels = np.flatnonzero(motion.counts.any(0))
        told = motion.compared(np.ones_like(motion.torque))[:, self.channels]
        self.unit = motion.floor[self.channels] * np.sqrt((told**2).mean(0))
        self._dynamics = InverseDynamics(robot, motion)
        self.readings = self._as_channels(motion.torque)

    def predict(self, variants: Sequence[Assignment]) -> Array:
        """Channels (P, R, C)."""
        return np.array([self._predicted(variant) for variant in variants])

    def _predicted(self, variant: Assignment) -> Array:
        try:
            return self._as_channels(
                self._dynamics.torques(changed(self.robot, [self._listed, variant]))
            )
        except RobotError:
            return np.full(self.readings.shape, np.nan)

    def _as_channels(self, torque: Array) -> Array:
        return np.asarray(self.motion.compared(torque)[:, self.channels] / self.unit)
