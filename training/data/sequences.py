"""Sequences of samples in motion: tensions along trajectories, with the contacts behind them.

Commands are as people and controllers give them: moves from pose to pose, and streams of steps.
Contacts come, grow, turn and go. True tensions come from MuJoCo in time, or along a quasi-static
path where the arm is history-dependent.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass as options_dataclass

from cablesense_base import Array
from cablesense_base.workers import WorkerPool
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.dynamics import ArmDynamics
from cablesense_sim.effects.registry import EffectEntry, amended, transmissions
from cablesense_sim.equilibrium import held_lengths_m, solve_equilibrium
from cablesense_sim.joint_motion import JointMotion
from cablesense_sim.loads import normal_force_n
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.replay import read_tensions_n
from cablesense_training.data.dataset import RunRows
from cablesense_training.data.generation import sensed_along_n, solved_rows, tensions_along_n
from cablesense_training.data.protocols import Options, PoseRange, Readings, chunk_sizes
from cablesense_training.errors import DatasetError


@options_dataclass(frozen=True, kw_only=True)
class MotionProtocol(Options):
    """Options of a run of sequences.

    Attributes:
        sequences: number of independent sequences.
        tick_s: time from sample to sample.
        pose_range_deg: joint angles are commanded within plus or minus this.
        joint_speed_deg_s: peak speed of a move, as the parameter of that name of the nodes.
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

    pose: ClassVar[str] = "random"

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
    """One contact at a time, with pauses between; many swell or turn a little while they last."""
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


@dataclass(frozen=True, eq=False)
class Sequences(RunRows):
    """S sequences of T ticks of an arm with N segments and M cables.

    Attributes:
        before_rad: (S, W, 2N) set-points before the first tick, from rest to rest, as far as an
            estimator knows them: one that was started later knows of the last alone.
        tension_difference_n: (S, T, M) readings minus the unloaded tensions at the set-point: the
            tare of the sequence's start, carried along by the arm's model.
        joint_command_rad, joint_speed_rad_s, joint_acceleration_rad_s2: (S, T, 2N) set-points.
        segment: (S, T) touched segment, 0 for none.
        angle_deg, magnitude_n: (S, T) of the contact at the set-point; 0 where nothing touches.
    """

    protocol: MotionProtocol
    before_rad: Array
    tension_difference_n: Array
    joint_command_rad: Array
    joint_speed_rad_s: Array
    joint_acceleration_rad_s2: Array
    segment: NDArray[np.int64]
    angle_deg: Array
    magnitude_n: Array

    def __len__(self) -> int:
        return len(self.segment)

    @property
    def inputs(self) -> tuple[Array, Array, Array, Array]:
        """What an estimator receives: tension differences and set-points, each (S, T, …)."""
        set_points = self.joint_command_rad, self.joint_speed_rad_s, self.joint_acceleration_rad_s2
        return self.tension_difference_n, *set_points


_SHARE_STARTED_LATE = 0.4
"""Sequences whose estimator was started just before the tare, when the arm had moved already."""

_BLOCK_SEQUENCES = 32
"""Sequences that one worker draws at a time; each block has its random stream."""


def draw_sequences(
    arm: Arm,
    protocol: MotionProtocol,
    seed: int,
    *,
    workers: int = 1,
    on_done: Callable[[int], None] = lambda _: None,
) -> Sequences:
    """The sequences that arm, protocol and seed determine; `on_done` counts them.

    Sequences in which the arm finds no rest are left out.

    Raises:
        DatasetError: none is left.
    """
    counts = chunk_sizes(protocol.sequences, _BLOCK_SEQUENCES)
    parts: list[Sequences] = []
    with WorkerPool(min(workers, len(counts)), arm, protocol, seed, refusal=DatasetError) as pool:
        results = pool.map(_draw_block, range(len(counts)), counts)
        for part, count in zip(results, counts, strict=True):
            parts.append(part)
            on_done(count)
    drawn = Sequences.concatenate(parts)
    if not len(drawn):
        raise DatasetError("no sequences: every one of them lay beyond the arm")
    return drawn


def _draw_block(
    arm: Arm, protocol: MotionProtocol, seed: int, block: int, count: int
) -> Sequences:
    """Some sequences of a run, by their block's number."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(block,)))
    nominal, entries = mechanism_of(arm), entries_of(arm)
    motions = [drawn_motion(protocol, arm.joint_count, rng) for _ in range(count)]
    contacts = [drawn_contacts(protocol, arm.segment_count, rng) for _ in range(count)]
    command = np.stack([motion.angle_rad for motion in motions])
    segment, angle, magnitude = (np.stack(parts) for parts in zip(*contacts, strict=True))
    forces = normal_force_n(nominal, command, segment, angle, magnitude)
    before = drawn_before(command[:, 0], np.abs(command).max(), rng)
    if transmissions([entries]):
        true = _quasi_static_tensions_n(nominal, entries, before, command, forces, protocol.tick_s)
    else:
        moved = zip(motions, forces, strict=True)
        true = np.stack([_tensions_in_time_n(arm, motion, loads) for motion, loads in moved])
    time_s = np.arange(protocol.ticks, dtype=float) * protocol.tick_s
    sensed = sensed_along_n(entries, time_s, true)
    reading, tare = sensed, sensed[:, :1]
    if protocol.noise:
        reading = read_tensions_n(sensed, arm.sensors, rng)
        repeated = np.repeat(sensed[:, :1], protocol.tare_samples, axis=1)
        tare = read_tensions_n(repeated, arm.sensors, rng).mean(axis=1, keepdims=True)
    held = held_lengths_m(nominal, command)
    predicted = solve_equilibrium(amended(nominal, entries), command, held_m=held).tensions_n
    late = rng.random(count) < _SHARE_STARTED_LATE
    return Sequences(
        arm=arm,
        protocol=protocol,
        seed=seed,
        before_rad=np.where(late[:, None, None], before[:, -1:], before),
        tension_difference_n=reading - tare - (predicted - predicted[:, :1]),
        joint_command_rad=command,
        joint_speed_rad_s=np.stack([motion.speed_rad_s for motion in motions]),
        joint_acceleration_rad_s2=np.stack([m.acceleration_rad_s2 for m in motions]),
        segment=segment,
        angle_deg=angle,
        magnitude_n=magnitude,
    ).select(np.isfinite(true).all(axis=(1, 2)))


def _tensions_in_time_n(arm: Arm, motion: CommandedMotion, forces_n: Array) -> Array:
    """(T, M) tensions of a memoryless arm under loads (T, N, 3), at rest at the start."""
    dynamics = ArmDynamics(arm, STEP_S)
    dynamics.reset(motion.angle_rad[0])
    found = np.empty((len(forces_n), arm.cable_count))
    for tick, loads in enumerate(forces_n):
        for segment, force in enumerate(loads, start=1):
            dynamics.load(segment, force)
        for angles in motion.fine_rad[tick]:
            dynamics.command(angles)
            dynamics.advance(STEP_S)
        found[tick] = dynamics.tensions_n
    return found


def _quasi_static_tensions_n(
    nominal: Mechanism,
    entries: list[EffectEntry],
    before_rad: Array,
    command_rad: Array,
    forces_n: Array,
    tick_s: float,
) -> Array:
    """(S, T, M) tensions of history-dependent arms, side by side, under loads (S, T, N, 3).

    Set-points are (S, W, 2N) before the first tick, then (S, T, 2N). NaN for sequences in which an
    arm finds no rest.
    """
    before = before_rad.shape[1]
    path = np.concatenate([before_rad, command_rad], axis=1).swapaxes(0, 1)
    loads = np.pad(forces_n, ((0, 0), (before, 0), (0, 0), (0, 0))).swapaxes(0, 1)
    time_s = np.arange(len(path), dtype=float) * tick_s

    def tensions_n(rows: NDArray[np.int64]) -> Array:
        return tensions_along_n(nominal, entries, time_s, path[:, rows], loads[:, rows])

    shape = (*path.shape[:2], nominal.cable_count)
    return solved_rows(shape, path.shape[1], tensions_n)[before:].swapaxes(0, 1)
