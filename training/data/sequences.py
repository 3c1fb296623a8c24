"""Sequences of samples in motion: tensions along trajectories, with the contacts behind them.

`draw_sequences` gives those that arm, protocol and seed determine, the same for any number of
worker processes. True tensions come from MuJoCo in time, or along a quasi-static path where the
arm is history-dependent.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablesense_base.arrays import Array
from cablesense_base.workers import WorkerPool
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.dynamics import ArmDynamics
from cablesense_sim.effects.registry import actuations, amended, sensings, transmissions
from cablesense_sim.equilibrium import EquilibriumError, held_lengths_m, solve_equilibrium
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.quasi_static import QuasiStaticArm
from cablesense_sim.replay import read_tensions_n
from cablesense_training.data.dataset import contact_forces_n
from cablesense_training.data.motion_protocol import (
    STEP_S,
    CommandedMotion,
    ContactTrajectory,
    MotionProtocol,
    drawn_before,
    drawn_contacts,
    drawn_motion,
)
from cablesense_training.errors import DatasetError


@dataclass(frozen=True, eq=False)
class Sequences:
    """S sequences of T ticks of an arm with N segments and M cables.

    Attributes:
        arm, protocol, seed: what determines them.
        before_rad: (S, W, 2N) set-points before the first tick, from rest to rest, as far as an
            estimator knows them: one that was started later knows of the last alone.
        tension_difference_n: (S, T, M) readings less the unloaded tensions at the set-point: the
            tare of the sequence's start, carried along by the arm's model.
        joint_command_rad, joint_speed_rad_s, joint_acceleration_rad_s2: (S, T, 2N) set-points.
        segment: (S, T) touched segment, 0 for none.
        angle_deg: (S, T) contact angle at the set-point; 0 where nothing touches.
        magnitude_n: (S, T) force; 0 where nothing touches.
    """

    arm: Arm
    protocol: MotionProtocol
    seed: int
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
    def ticks(self) -> int:
        """Samples in a sequence."""
        return int(self.segment.shape[1])

    @property
    def moving(self) -> NDArray[np.bool_]:
        """(S, T) whether the set-point moves."""
        return np.asarray((self.joint_speed_rad_s != 0.0).any(axis=-1))

    def select(self, rows: Any) -> Sequences:
        """Some of the sequences, in the order given."""
        return replace(self, **{name: getattr(self, name)[rows] for name in ARRAY_NAMES})

    @classmethod
    def concatenate(cls, parts: list[Sequences]) -> Sequences:
        """Parts of one run, in order.

        Raises:
            DatasetError: no parts.
        """
        if not parts:
            raise DatasetError("no sequences: every one of them lay beyond the arm")
        arrays: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts]) for name in ARRAY_NAMES
        }
        return replace(parts[0], **arrays)


ARRAY_NAMES = tuple(f.name for f in fields(Sequences) if f.name not in ("arm", "protocol", "seed"))
"""Names of the arrays that have one row per sequence."""


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
    arm: Arm, before_rad: Array, command_rad: Array, forces_n: Array, tick_s: float
) -> Array:
    """(S, T, M) tensions of history-dependent arms, side by side, under loads (S, T, N, 3).

    Each goes through set-points (S, W, 2N) before those (S, T, 2N) that are asked for. NaN for
    sequences in which an arm finds no rest.
    """
    before = before_rad.shape[1]
    path = np.concatenate([before_rad, command_rad], axis=1).swapaxes(0, 1)
    loads = np.pad(forces_n, ((0, 0), (before, 0), (0, 0), (0, 0))).swapaxes(0, 1)
    found = np.full((*path.shape[:2], arm.cable_count), np.nan)
    rows = np.arange(path.shape[1])
    while rows.size:
        try:
            found[:, rows] = _along_path_n(arm, path[:, rows], loads[:, rows], tick_s)
        except EquilibriumError as error:
            if not error.failed.size:
                raise
            rows = np.delete(rows, error.failed)
            continue
        break
    return found[before:].swapaxes(0, 1)


def _along_path_n(arm: Arm, path_rad: Array, loads_n: Array, tick_s: float) -> Array:
    entries, nominal = entries_of(arm), mechanism_of(arm)
    count = path_rad.shape[1]
    quasi_static = QuasiStaticArm([amended(nominal, entries)] * count, [entries] * count)
    acting = actuations([entries] * count)
    found = np.empty((len(path_rad), count, arm.cable_count))
    for tick, command in enumerate(path_rad):
        held = held_lengths_m(nominal, command)
        for actuation in acting:
            held = actuation.step(tick * tick_s, held)
        found[tick] = quasi_static.step(tick * tick_s, held, loads_n[tick])
    return found


SHARE_STARTED_LATE = 0.4
"""Sequences whose estimator was started just before the tare, when the arm had moved already."""

BLOCK_SEQUENCES = 32
"""Sequences that one worker draws at a time; each block has a random stream of its own."""


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
    full, rest = divmod(protocol.sequences, BLOCK_SEQUENCES)
    counts = [BLOCK_SEQUENCES] * full + [rest] * (rest > 0)
    parts: list[Sequences] = []
    with WorkerPool(min(workers, len(counts)), arm, protocol, seed, refusal=DatasetError) as pool:
        results = pool.map(_draw_block, range(len(counts)), counts)
        for part, count in zip(results, counts, strict=True):
            parts.append(part)
            if on_done is not None:
                on_done(count)
    return Sequences.concatenate([part for part in parts if len(part)])


def _draw_block(
    arm: Arm, protocol: MotionProtocol, seed: int, block: int, count: int
) -> Sequences:
    """Some sequences of a run, by their block's number."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(block,)))
    nominal, entries = mechanism_of(arm), entries_of(arm)
    motions = [drawn_motion(protocol, arm.joint_count, rng) for _ in range(count)]
    contacts = [drawn_contacts(protocol, arm.segment_count, rng) for _ in range(count)]
    command = np.stack([motion.angle_rad for motion in motions])
    forces = np.stack(
        [
            _forces_n(nominal, pose, contact)
            for pose, contact in zip(command, contacts, strict=True)
        ]
    )
    before = drawn_before(command[:, 0], np.abs(command).max(), rng)
    if transmissions([entries]):
        true = _quasi_static_tensions_n(arm, before, command, forces, protocol.tick_s)
    else:
        moved = zip(motions, forces, strict=True)
        true = np.stack([_tensions_in_time_n(arm, motion, loads) for motion, loads in moved])
    sensed = _sensed_n(arm, true, protocol.tick_s)
    reading, tare = sensed, sensed[:, :1]
    if protocol.noise:
        reading = read_tensions_n(sensed, arm.sensors, rng)
        repeated = np.repeat(sensed[:, :1], protocol.tare_samples, axis=1)
        tare = read_tensions_n(repeated, arm.sensors, rng).mean(axis=1, keepdims=True)
    held = held_lengths_m(nominal, command)
    predicted = solve_equilibrium(amended(nominal, entries), command, held_m=held).tensions_n
    whole = np.isfinite(true).all(axis=(1, 2))
    late = rng.random(count) < SHARE_STARTED_LATE
    return Sequences(
        arm=arm,
        protocol=protocol,
        seed=seed,
        before_rad=np.where(late[:, None, None], before[:, -1:], before),
        tension_difference_n=reading - tare - (predicted - predicted[:, :1]),
        joint_command_rad=command,
        joint_speed_rad_s=np.stack([motion.speed_rad_s for motion in motions]),
        joint_acceleration_rad_s2=np.stack([m.acceleration_rad_s2 for m in motions]),
        segment=np.stack([contact.segment for contact in contacts]),
        angle_deg=np.stack([contact.angle_deg for contact in contacts]),
        magnitude_n=np.stack([contact.magnitude_n for contact in contacts]),
    ).select(whole)


def _forces_n(mechanism: Mechanism, command_rad: Array, contact: ContactTrajectory) -> Array:
    """(T, N, 3) forces in base axes, normal to the touched segment at the set-points."""
    here = contact.segment[:, None] == np.arange(1, mechanism.segment_count + 1)
    angles = np.where(here, contact.angle_deg[:, None], 0.0)
    magnitudes = np.where(here, contact.magnitude_n[:, None], 0.0)
    return contact_forces_n(mechanism, command_rad, angles, magnitudes)


def _sensed_n(arm: Arm, true_n: Array, tick_s: float) -> Array:
    """What sensors that lag, drift or mix their channels make of tensions (S, T, M)."""
    entries = entries_of(arm)
    sensed = true_n
    for sensing in sensings([entries] * len(true_n)):
        ticks = [sensing.step(t * tick_s, sensed[:, t]) for t in range(sensed.shape[1])]
        sensed = np.stack(ticks, axis=1)
    return sensed
