"""Sequences from arm, protocol and seed; the same for any number of worker processes."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial

import numpy as np
from numpy.typing import NDArray

from cablesense_sim.arm import Arm
from cablesense_sim.effects.chains import amended, memories, sensings
from cablesense_sim.effects.entry import entries_of
from cablesense_sim.equilibrium import held_lengths_m, solve_equilibrium
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.sensors import read_tensions_n
from cablesense_training.data.loads import contact_forces_n
from cablesense_training.motion.commanded_motion import drawn_before, drawn_motion
from cablesense_training.motion.contact_course import ContactCourse, drawn_contacts
from cablesense_training.motion.motion_protocol import MotionProtocol
from cablesense_training.motion.moving_tensions import (
    tensions_from_rest_to_rest_n,
    tensions_in_time_n,
)
from cablesense_training.motion.sequences import Sequences

Array = NDArray[np.float64]

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
    """The sequences that arm, protocol and seed determine; `on_done` is told how many are.

    Sequences in which the arm finds no rest are left out.

    Raises:
        DatasetError: none is left.
    """
    counts = _block_sizes(protocol.sequences)
    draw = partial(draw_block, arm, protocol, seed)
    parts: list[Sequences] = []
    if min(workers, len(counts)) == 1:
        for block, count in enumerate(counts):
            parts.append(draw(block, count))
            _tell(on_done, count)
    else:
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(workers, mp_context=context) as pool:
            results = pool.map(draw, range(len(counts)), counts)
            for part, count in zip(results, counts, strict=True):
                parts.append(part)
                _tell(on_done, count)
    return Sequences.concatenate([part for part in parts if len(part)])


def draw_block(arm: Arm, protocol: MotionProtocol, seed: int, block: int, count: int) -> Sequences:
    """Some sequences of a run, by their block's number."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(block,)))
    nominal, entries = Mechanism.from_arm(arm), entries_of(arm)
    motions = [drawn_motion(protocol, arm.joint_count, rng) for _ in range(count)]
    contacts = [drawn_contacts(protocol, arm.segment_count, rng) for _ in range(count)]
    command = np.stack([motion.angle_rad for motion in motions])
    forces = np.stack(
        [_forces_n(nominal, pose, course) for pose, course in zip(command, contacts, strict=True)]
    )
    before = drawn_before(command[:, 0], np.abs(command).max(), rng)
    if memories([entries]):
        true = tensions_from_rest_to_rest_n(arm, before, command, forces, protocol.tick_s)
    else:
        pairs = zip(motions, forces, strict=True)
        true = np.stack([tensions_in_time_n(arm, motion, loads) for motion, loads in pairs])
    sensed = _sensed_n(arm, true, protocol.tick_s)
    reading, tare = sensed, sensed[:, :1]
    if protocol.noise:
        reading = read_tensions_n(sensed, arm.sensors, rng)
        repeated = np.repeat(sensed[:, :1], protocol.tare_samples, axis=1)
        tare = read_tensions_n(repeated, arm.sensors, rng).mean(axis=1, keepdims=True)
    held = held_lengths_m(nominal, command)
    predicted = solve_equilibrium(amended(nominal, entries), command, held_m=held).tensions_n
    whole = np.isfinite(true).all(axis=(1, 2))
    return Sequences(
        arm=arm,
        protocol=protocol,
        seed=seed,
        before_rad=_as_known(before, rng),
        tension_difference_n=reading - tare - (predicted - predicted[:, :1]),
        joint_command_rad=command,
        joint_speed_rad_s=np.stack([motion.speed_rad_s for motion in motions]),
        joint_acceleration_rad_s2=np.stack([m.acceleration_rad_s2 for m in motions]),
        segment=np.stack([course.segment for course in contacts]),
        angle_deg=np.stack([course.angle_deg for course in contacts]),
        magnitude_n=np.stack([course.magnitude_n for course in contacts]),
    ).select(whole)


def _as_known(before_rad: Array, rng: np.random.Generator) -> Array:
    """What an estimator knows of set-points (S, W, 2N): nothing, where it was started later."""
    late = rng.random(len(before_rad)) < SHARE_STARTED_LATE
    return np.where(late[:, None, None], before_rad[:, -1:], before_rad)


def _forces_n(mechanism: Mechanism, command_rad: Array, course: ContactCourse) -> Array:
    """(T, N, 3) forces in base axes, normal to the touched segment at the set-points."""
    here = course.segment[:, None] == np.arange(1, mechanism.segment_count + 1)
    angles = np.where(here, course.angle_deg[:, None], 0.0)
    magnitudes = np.where(here, course.magnitude_n[:, None], 0.0)
    return contact_forces_n(mechanism, command_rad, angles, magnitudes)


def _sensed_n(arm: Arm, true_n: Array, tick_s: float) -> Array:
    """What sensors that lag, drift or mix their channels make of tensions (S, T, M)."""
    entries = entries_of(arm)
    sensed = true_n
    for sensing in sensings([entries] * len(true_n)):
        ticks = [sensing.step(t * tick_s, sensed[:, t]) for t in range(sensed.shape[1])]
        sensed = np.stack(ticks, axis=1)
    return sensed


def _block_sizes(count: int) -> list[int]:
    full, rest = divmod(count, BLOCK_SEQUENCES)
    return [BLOCK_SEQUENCES] * full + ([rest] if rest else [])


def _tell(on_done: Callable[[int], None] | None, count: int) -> None:
    if on_done is not None:
        on_done(count)
