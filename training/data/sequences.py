"""Sequences of samples in motion: tensions along trajectories, with the contacts behind them.

`draw_sequences` gives those that arm, protocol and seed determine, the same for any number of
worker processes. True tensions come from MuJoCo in time, or along a quasi-static path where the
arm is history-dependent.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array
from cablesense_base.workers import WorkerPool
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.dynamics import ArmDynamics
from cablesense_sim.effects.registry import EffectEntry, amended, transmissions
from cablesense_sim.equilibrium import held_lengths_m, solve_equilibrium
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.replay import read_tensions_n
from cablesense_training.data.dataset import RunRows, contact_forces_n
from cablesense_training.data.history import sensed_along_n, solved_rows, tensions_along_n
from cablesense_training.data.motion_protocol import (
    STEP_S,
    CommandedMotion,
    MotionProtocol,
    drawn_before,
    drawn_contacts,
    drawn_motion,
)
from cablesense_training.errors import DatasetError


@dataclass(frozen=True, eq=False)
class Sequences(RunRows):
    """S sequences of T ticks of an arm with N segments and M cables.

    Attributes:
        arm, protocol, seed: what determines them.
        before_rad: (S, W, 2N) set-points before the first tick, from rest to rest, as far as an
            estimator knows them: one that was started later knows of the last alone.
        tension_difference_n: (S, T, M) readings minus the unloaded tensions at the set-point: the
            tare of the sequence's start, carried along by the arm's model.
        joint_command_rad, joint_speed_rad_s, joint_acceleration_rad_s2: (S, T, 2N) set-points.
        segment: (S, T) touched segment, 0 for none.
        angle_deg: (S, T) contact angle at the set-point; 0 where nothing touches.
        magnitude_n: (S, T) force; 0 where nothing touches.
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
    on_done: Callable[[int], None] | None = None,
) -> Sequences:
    """The sequences that arm, protocol and seed determine; `on_done` counts them.

    Sequences in which the arm finds no rest are left out.

    Raises:
        DatasetError: none is left.
    """
    full, rest = divmod(protocol.sequences, _BLOCK_SEQUENCES)
    counts = [_BLOCK_SEQUENCES] * full + [rest] * (rest > 0)
    parts: list[Sequences] = []
    with WorkerPool(min(workers, len(counts)), arm, protocol, seed, refusal=DatasetError) as pool:
        results = pool.map(_draw_block, range(len(counts)), counts)
        for part, count in zip(results, counts, strict=True):
            parts.append(part)
            if on_done is not None:
                on_done(count)
    parts = [part for part in parts if len(part)]
    if not parts:
        raise DatasetError("no sequences: every one of them lay beyond the arm")
    return Sequences.concatenate(parts)


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
    forces = _forces_n(nominal, command, segment, angle, magnitude)
    before = drawn_before(command[:, 0], np.abs(command).max(), rng)
    if transmissions([entries]):
        true = _quasi_static_tensions_n(nominal, entries, before, command, forces, protocol.tick_s)
    else:
        moved = zip(motions, forces, strict=True)
        true = np.stack([_tensions_in_time_n(arm, motion, loads) for motion, loads in moved])
    time_s = np.arange(protocol.ticks, dtype=float) * protocol.tick_s
    sensed = sensed_along_n(entries, time_s, true.swapaxes(0, 1)).swapaxes(0, 1)
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


def _forces_n(
    mechanism: Mechanism,
    command_rad: Array,
    segment: NDArray[np.int64],
    angle_deg: Array,
    magnitude_n: Array,
) -> Array:
    """(S, T, N, 3) forces in base axes, normal to the touched segment at the set-points."""
    here = segment[..., None] == np.arange(1, mechanism.segment_count + 1)
    rows = here.reshape(-1, mechanism.segment_count)
    angles, magnitudes = (
        np.where(rows, values.reshape(-1, 1), 0.0) for values in (angle_deg, magnitude_n)
    )
    poses = command_rad.reshape(len(rows), -1)
    return contact_forces_n(mechanism, poses, angles, magnitudes).reshape(*here.shape, 3)


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

    Each goes through set-points (S, W, 2N) before those (S, T, 2N) that are asked for. NaN for
    sequences in which an arm finds no rest.
    """
    before = before_rad.shape[1]
    path = np.concatenate([before_rad, command_rad], axis=1).swapaxes(0, 1)
    loads = np.pad(forces_n, ((0, 0), (before, 0), (0, 0), (0, 0))).swapaxes(0, 1)
    time_s, ticks = np.arange(len(path), dtype=float) * tick_s, range(len(path))

    def tensions_n(rows: NDArray[np.int64]) -> Array:
        return tensions_along_n(nominal, entries, time_s, path[:, rows], loads[:, rows], ticks)

    shape = (*path.shape[:2], nominal.cable_count)
    return solved_rows(shape, path.shape[1], tensions_n)[before:].swapaxes(0, 1)
