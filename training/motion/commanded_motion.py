"""Commands as people and controllers give them: moves from pose to pose, and streams of steps."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cablesense_sim.joint_motion import JointMotion
from cablesense_training.motion.motion_protocol import MotionProtocol

Array = NDArray[np.float64]

STEP_S = 1e-3
"""Set-points are given this often, as the sim node does."""

_MOVES_BEFORE = 3
_TICKS_BEFORE = 25
"""In each of these moves."""

_SHARE_OF_STREAMS = 0.4
_SHARE_OF_SINGLE_JOINTS = 0.3
_STREAM_EVERY_S = (0.02, 0.1)
_STREAM_LASTS_S = (1.0, 5.0)
_MEAN_DWELL_S = 1.2
_SHARE_OF_LONG_DWELLS = 0.15
_LONG_DWELL_S = (3.0, 10.0)


class CommandedMotion(NamedTuple):
    """Set-points of T ticks.

    Attributes:
        angle_rad, speed_rad_s, acceleration_rad_s2: (T, 2N) at the end of each tick.
        fine_rad: (T, K, 2N) angles at the K steps of `STEP_S` that end in each tick.
    """

    angle_rad: Array
    speed_rad_s: Array
    acceleration_rad_s2: Array
    fine_rad: Array


def drawn_motion(
    protocol: MotionProtocol, joint_count: int, rng: np.random.Generator
) -> CommandedMotion:
    """A course through random poses, beginning at rest at one of them."""
    reach = np.deg2rad(protocol.pose_range_deg)
    start = rng.uniform(-reach, reach, joint_count)
    motion = JointMotion(start, np.deg2rad(protocol.joint_speed_deg_s))
    commander = _Commander(protocol, start, rng)
    inner = max(1, round(protocol.tick_s / STEP_S))
    shape = (protocol.ticks, joint_count)
    angle, speed, acceleration = np.empty(shape), np.empty(shape), np.empty(shape)
    fine = np.empty((protocol.ticks, inner, joint_count))
    for tick in range(protocol.ticks):
        command = commander.at(tick * protocol.tick_s)
        if command is not None:
            motion.go_to(command)
        for step in range(inner):
            fine[tick, step] = motion.advance(protocol.tick_s / inner)
        angle[tick], speed[tick], acceleration[tick] = motion.state
    return CommandedMotion(angle, speed, acceleration, fine)


def drawn_before(start_rad: Array, reach_rad: float, rng: np.random.Generator) -> Array:
    """(S, W, 2N) set-points that lead through random poses to `start_rad` (S, 2N).

    They give the friction of each arm a past, and whoever counts commands knows it.
    """
    poses = [rng.uniform(-reach_rad, reach_rad, start_rad.shape) for _ in range(_MOVES_BEFORE)]
    poses.append(start_rad)
    share = np.linspace(0.0, 1.0, _TICKS_BEFORE)[:, None, None]
    way = [here + share * (there - here) for here, there in pairwise(poses)]
    return np.concatenate(way).swapaxes(0, 1)


class _Commander:
    """Gives the next command when its time has come."""

    def __init__(
        self, protocol: MotionProtocol, start_rad: Array, rng: np.random.Generator
    ) -> None:
        self._rng, self._reach = rng, np.deg2rad(protocol.pose_range_deg)
        self._speed = np.deg2rad(protocol.joint_speed_deg_s)
        self._command = start_rad.copy()
        self._next_s = rng.exponential(_MEAN_DWELL_S)
        self._stream_until_s = -1.0
        self._every_s = 0.0
        self._velocity = np.zeros_like(start_rad)

    def at(self, time_s: float) -> Array | None:
        """The command (2N,) that is due, or None."""
        if time_s < self._next_s:
            return None
        rng = self._rng
        if time_s < self._stream_until_s:
            self._step()
            self._next_s = time_s + self._every_s
        elif rng.random() < _SHARE_OF_STREAMS:
            self._every_s = rng.uniform(*_STREAM_EVERY_S)
            self._stream_until_s = time_s + rng.uniform(*_STREAM_LASTS_S)
            self._velocity = self._drawn_velocity()
            self._step()
            self._next_s = time_s + self._every_s
        else:
            moved = np.ones(len(self._command), dtype=bool)
            if rng.random() < _SHARE_OF_SINGLE_JOINTS:
                moved[:] = False
                moved[rng.integers(len(moved))] = True
            drawn = rng.uniform(-self._reach, self._reach, len(moved))
            way = np.abs(np.where(moved, drawn - self._command, 0.0)).max()
            self._command = np.where(moved, drawn, self._command)
            self._next_s = time_s + 1.9 * way / self._speed + self._dwell_s()
        return self._command.copy()

    def _drawn_velocity(self) -> Array:
        size = self._speed * self._rng.uniform(0.0, 0.5)
        return self._rng.normal(0.0, 0.6, len(self._command)) * size

    def _step(self) -> None:
        turned = self._velocity + 0.3 * self._drawn_velocity()
        ahead = self._command + turned * self._every_s
        out = np.abs(ahead) > self._reach
        self._velocity = np.where(out, -turned, turned)
        self._command = np.clip(ahead, -self._reach, self._reach)

    def _dwell_s(self) -> float:
        if self._rng.random() < _SHARE_OF_LONG_DWELLS:
            return float(self._rng.uniform(*_LONG_DWELL_S))
        return float(self._rng.exponential(_MEAN_DWELL_S))
