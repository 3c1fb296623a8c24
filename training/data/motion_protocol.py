"""The protocol of sequences of motion and contact.

`drawn_motion` gives commands as people and controllers do: moves from pose to pose, and streams of
steps. `drawn_contacts` gives contacts that come and go: segment, direction and force by tick.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from cablesense_base import Array
from cablesense_sim.joint_motion import JointMotion
from cablesense_training.data.protocols import Options, PoseRange, Readings
from cablesense_training.errors import DatasetError


@dataclass(frozen=True, kw_only=True)
class MotionProtocol(Options):
    """Options of a run of sequences.

    Attributes:
        sequences: number of sequences, independent of each other.
        duration_s: of each.
        tick_s: time from sample to sample.
        pose_range_deg: joint angles are commanded within plus or minus this.
        joint_speed_deg_s: peak speed of a move, as the parameter of that name of sim and
            estimator.
        force_high_n: strongest contact.
        tare_samples: readings averaged into the unloaded state, which is taken once, at the start.
        noise: whether the sensors' noise and step act.
    """

    sequences: Annotated[int, Field(ge=1, le=1_000_000)] = 256
    duration_s: Annotated[float, Field(le=3600.0)] = 30.0
    tick_s: Annotated[float, Field(ge=1e-3, le=1.0)] = 0.02
    pose_range_deg: PoseRange = 10.0
    joint_speed_deg_s: Annotated[float, Field(ge=0.1, le=1000.0)] = 20.0
    force_high_n: Annotated[float, Field(ge=0.1, le=10_000.0)] = 100.0
    tare_samples: Readings = 50
    noise: bool = True

    def __post_init__(self) -> None:
        if self.duration_s < self.tick_s:
            raise DatasetError(
                f"duration_s = {self.duration_s:g}: must be at least a tick, {self.tick_s:g} s"
            )

    @property
    def ticks(self) -> int:
        """Samples in a sequence."""
        return max(1, round(self.duration_s / self.tick_s))


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
    """A trajectory through random poses, beginning at rest at one of them."""
    reach = np.deg2rad(protocol.pose_range_deg)
    start = rng.uniform(-reach, reach, joint_count)
    motion = JointMotion(start, np.deg2rad(protocol.joint_speed_deg_s))
    inner = max(1, round(protocol.tick_s / STEP_S))
    shape = (protocol.ticks, joint_count)
    angle, speed, acceleration = np.empty(shape), np.empty(shape), np.empty(shape)
    fine = np.empty((protocol.ticks, inner, joint_count))
    for tick, command in enumerate(_commands(protocol, start, rng)):
        if command is not None:
            motion.go_to(command)
        for step in range(inner):
            fine[tick, step] = motion.advance(protocol.tick_s / inner)
        angle[tick], speed[tick], acceleration[tick] = motion.state
    return CommandedMotion(angle, speed, acceleration, fine)


def drawn_before(start_rad: Array, reach_rad: float, rng: np.random.Generator) -> Array:
    """(S, W, 2N) set-points that lead through random poses to `start_rad` (S, 2N).

    They give the friction of each arm a history that follows from the commands.
    """
    poses = [rng.uniform(-reach_rad, reach_rad, start_rad.shape) for _ in range(_MOVES_BEFORE)]
    poses.append(start_rad)
    share = np.linspace(0.0, 1.0, _TICKS_BEFORE)[:, None, None]
    way = [here + share * (there - here) for here, there in pairwise(poses)]
    return np.concatenate(way).swapaxes(0, 1)


def _commands(
    protocol: MotionProtocol, command_rad: Array, rng: np.random.Generator
) -> Iterator[Array | None]:
    """The command (2N,) that is due at each tick, or None."""
    reach, speed = np.deg2rad(protocol.pose_range_deg), np.deg2rad(protocol.joint_speed_deg_s)

    def drawn_velocity() -> Array:
        size = speed * rng.uniform(0.0, 0.5)
        return rng.normal(0.0, 0.6, len(command_rad)) * size

    next_s, stream_until_s, every_s = rng.exponential(_MEAN_DWELL_S), -1.0, 0.0
    velocity = np.zeros_like(command_rad)
    for tick in range(protocol.ticks):
        time_s = tick * protocol.tick_s
        if time_s < next_s:
            yield None
            continue
        streams = time_s < stream_until_s
        if not streams and rng.random() < _SHARE_OF_STREAMS:
            streams = True
            every_s = rng.uniform(*_STREAM_EVERY_S)
            stream_until_s = time_s + rng.uniform(*_STREAM_LASTS_S)
            velocity = drawn_velocity()
        if streams:
            turned = velocity + 0.3 * drawn_velocity()
            ahead = command_rad + turned * every_s
            velocity = np.where(np.abs(ahead) > reach, -turned, turned)
            command_rad = np.clip(ahead, -reach, reach)
            next_s = time_s + every_s
        else:
            moved = np.ones(len(command_rad), dtype=bool)
            if rng.random() < _SHARE_OF_SINGLE_JOINTS:
                moved[:] = False
                moved[rng.integers(len(moved))] = True
            drawn = rng.uniform(-reach, reach, len(moved))
            way = np.abs(np.where(moved, drawn - command_rad, 0.0)).max()
            command_rad = np.where(moved, drawn, command_rad)
            if rng.random() < _SHARE_OF_LONG_DWELLS:
                dwell_s = rng.uniform(*_LONG_DWELL_S)
            else:
                dwell_s = rng.exponential(_MEAN_DWELL_S)
            next_s = time_s + 1.9 * way / speed + dwell_s
        yield command_rad


_MEAN_FREE_S = 2.0
_SHORTEST_FREE_S = 0.2
_MEAN_HOLD_S = 2.0
_LOG_RISE = (np.log(0.02), np.log(1.5))
_SHARE_OF_WEAK = 0.3
_WEAK_SHARE_OF_FORCE = 0.15
_MOST_TURNED_DEG_S = 20.0
_SWELL = 0.3
_SWELL_HZ = (0.2, 2.0)


class ContactTrajectory(NamedTuple):
    """Of T ticks: segment (T,), 0 for none; angle (T,), degrees; magnitude (T,), N."""

    segment: NDArray[np.int64]
    angle_deg: Array
    magnitude_n: Array


def drawn_contacts(
    protocol: MotionProtocol, segment_count: int, rng: np.random.Generator
) -> ContactTrajectory:
    """One contact at a time, with pauses between; most swell, and turn a little, while they last.

    A contact rises within 20 ms to 1.5 s, holds, and falls likewise. A third are weak.
    """
    ticks = protocol.ticks
    segment = np.zeros(ticks, dtype=np.int64)
    angle, magnitude = np.zeros(ticks), np.zeros(ticks)
    time_s = np.arange(ticks) * protocol.tick_s
    start_s = _SHORTEST_FREE_S + rng.exponential(_MEAN_FREE_S)
    while start_s < time_s[-1]:
        rise_s, fall_s = np.exp(rng.uniform(*_LOG_RISE, 2))
        hold_s = rng.exponential(_MEAN_HOLD_S)
        end_s = start_s + rise_s + hold_s + fall_s
        rows = np.flatnonzero((time_s > start_s) & (time_s < end_s))
        since = time_s[rows] - start_s
        peak = rng.uniform(0.0, protocol.force_high_n)
        if rng.random() < _SHARE_OF_WEAK:
            peak *= _WEAK_SHARE_OF_FORCE
        envelope = np.minimum(1.0, np.minimum(since / rise_s, (end_s - time_s[rows]) / fall_s))
        swell = rng.uniform(0.0, _SWELL) * (rng.random() < 0.5)
        phase = 2.0 * np.pi * (rng.uniform(*_SWELL_HZ) * since + rng.random())
        segment[rows] = rng.integers(1, segment_count + 1)
        magnitude[rows] = peak * envelope * (1.0 - swell * (0.5 + 0.5 * np.sin(phase)))
        turning = rng.uniform(-_MOST_TURNED_DEG_S, _MOST_TURNED_DEG_S) * (rng.random() < 0.5)
        angle[rows] = (rng.uniform(0.0, 360.0) + turning * since) % 360.0
        start_s = end_s + _SHORTEST_FREE_S + rng.exponential(_MEAN_FREE_S)
    return ContactTrajectory(segment, angle, magnitude)
