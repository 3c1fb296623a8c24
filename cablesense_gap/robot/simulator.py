"""A robot as the diagnosis simulates it: a `Simulator` of what its motion is compared by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_gap.robot.catalogue import candidate, changed, known_effects
from cablesense_gap.robot.effects.effect import RobotEffect
from cablesense_gap.robot.forward import ForwardComparison
from cablesense_gap.robot.inverse import InverseComparison
from cablesense_gap.robot.model import Change, Robot, RobotError
from cablesense_gap.robot.motion import Motion
from cablesense_gap.simulator import Assignment, Candidate

_PROBED, _USUAL = 0.01, 0.1
"""Rad or m of a zero: to see what it does, and as far as trials' own are off."""

_Zeros = tuple[NDArray[np.bool_], Array, Array]


class MotionComparison(Protocol):
    """Q rows of C channels that were measured, and that variants of a robot predict.

    Attributes:
        names, columns, units: of the channels, as verdicts and as tables call them.
        floor: (C,) what noise leaves of any model.
        noise: (C,) the same, over all rows, of which some may not count for a channel.
        readings: (Q, C) in those units.
        trial, time_s: (Q,).
        description: how it is compared, as a sentence.
    """

    names: tuple[str, ...]
    columns: tuple[str, ...]
    units: tuple[str, ...]
    floor: Array
    noise: Array
    readings: Array
    trial: NDArray[np.int64]
    time_s: Array
    description: str

    def predicted(self, change: Change) -> Array:
        """(Q, C) by a variant of the robot."""


class RobotSimulator:
    """What is compared, each channel in units of its own floor.

    Attributes: see `Simulator`, and
        comparison: what is compared, in its own units.
        readings: (Q, C) as measured.
    """

    floor = 1.0

    def __init__(self, robot: Robot, motion: Motion, listed: Assignment) -> None:
        """`motion` is what was measured, `listed` are effects that the nominal robot has."""
        self.robot, self._listed = robot, dict(listed)
        self.comparison: MotionComparison = (
            ForwardComparison(robot, motion)
            if motion.forward
            else InverseComparison(robot, motion)
        )
        effects = known_effects().values()
        offered = [
            (e, self._candidate(e, motion)) for e in effects if not (motion.zeroed and e.of_zeros)
        ]
        self.candidates = tuple(c for e, c in offered if not e.tolerance and c.places)
        self.tolerances = tuple(c for e, c in offered if e.tolerance)
        self.readings = self.comparison.readings / self.comparison.noise
        self._zeros: tuple[_Zeros, ...] = ()
        if motion.zeroed:
            self._zeros = self._of_zeros()

    def _candidate(self, effect: RobotEffect, motion: Motion) -> Candidate:
        """As it is offered; forward in time most friction is MuJoCo's, which gives no way."""
        found = candidate(effect, self.robot, motion.scale)
        if effect.presliding_forward or not motion.forward:
            return found
        return replace(found, parameters=tuple(p for p in found.parameters if p.role == "size"))

    def predict(self, variants: Sequence[Assignment]) -> Array:
        """Channels (P, Q, C)."""
        return np.array([self._predicted(variant) for variant in variants])

    def _predicted(self, variant: Assignment) -> Array:
        try:
            change = changed(self.robot, [self._listed, variant])
            found = self.comparison.predicted(change) / self.comparison.noise
        except RobotError:
            return np.full(self.readings.shape, np.nan)
        for rows, by_zeros, fitting in self._zeros:
            zeros = fitting @ (self.readings - found)[rows].ravel()
            found[rows] += (by_zeros @ zeros).reshape(-1, found.shape[1])
        return found

    def _of_zeros(self) -> tuple[_Zeros, ...]:
        """By trial its rows, what zeros (J,) make of them, and the zeros that fit a residual."""
        trial, joints = self.comparison.trial, self.robot.joints

        def read(joint: int, off: float) -> Array:
            change = changed(self.robot, [self._listed])
            change.zero[joint] += off
            return self.comparison.predicted(change) / self.comparison.noise

        ends = [[read(k, off) for k in range(len(joints))] for off in (_PROBED, -_PROBED)]
        by_zero = (np.array(ends[0]) - np.array(ends[1])) / (2.0 * _PROBED)
        found: list[_Zeros] = []
        for rows in (trial == number for number in np.unique(trial)):
            own = by_zero[:, rows].reshape(len(joints), -1).T
            known = own.T @ own + np.eye(len(joints)) / _USUAL**2
            found.append((rows, own, np.asarray(np.linalg.solve(known, own.T))))
        return tuple(found)
