"""Whether a residual repeats with the angle of a joint, or with the length of a cable.

Screws, gears and notches do; nothing that is smooth in the pose does. So what is smooth, a
polynomial of second degree in all commands, is taken out first, and waves of many periods are
fitted to the rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.recordings.recording import Recording
from cablesense_sim.arm import Arm
from cablesense_sim.equilibrium import held_lengths_m
from cablesense_sim.mechanism import Mechanism

Array = NDArray[np.float64]

FEWEST_ROWS = 100
LEAST_SHARE = 0.25
"""Of what is not smooth in the pose; a wave with another period than the true one has far less."""
ABOVE_FLOORS = 1.5
_WAVES = np.arange(1.5, 20.0, 0.25)
"""Periods that a range of motion may hold; slower waves cannot be told from what is smooth."""


@dataclass(frozen=True)
class Wave:
    """What repeats.

    Attributes:
        along: the joint angle or the cable, by its name.
        period: in `unit`.
        unit: `rad` or `m`.
        share: of what is not smooth in the pose.
    """

    along: str
    period: float
    unit: str
    share: float


def periodic(recording: Recording, residual_n: Array, floor_n: float, arm: Arm) -> Wave | None:
    """The wave that explains most of a residual (R, M) without load; None where none stands out.

    A joint's wave is sought in all cables, a cable's in its own readings.
    """
    free = recording.load_segment == 0
    command, residual = recording.command_rad[free], residual_n[free]
    moving = np.ptp(command, axis=0) > 0.0 if len(command) else np.zeros(0, dtype=bool)
    if len(command) < FEWEST_ROWS or not moving.any():
        return None
    smooth = _smooth(command[:, moving])
    rest = residual - smooth @ (smooth.T @ residual)
    if np.sqrt((rest**2).mean()) < ABOVE_FLOORS * floor_n:
        return None
    held_m = held_lengths_m(Mechanism.from_arm(arm), command)
    total = float((rest**2).sum())
    found = [
        _best(name, "rad", angle, rest, smooth, total)
        for name, angle in zip(arm.joint_names, command.T, strict=True)
    ]
    found += [
        _best(name, "m", length, rest[:, [c]], smooth, total)
        for c, (name, length) in enumerate(zip(arm.cable_names, held_m.T, strict=True))
    ]
    best = max(found, key=lambda wave: wave.share)
    return best if best.share >= LEAST_SHARE else None


def _best(name: str, unit: str, along: Array, rest: Array, smooth: Array, total: float) -> Wave:
    reach = float(np.ptp(along))
    if reach < 1e-6:
        return Wave(name, np.inf, unit, 0.0)
    shares = [_explained(2.0 * np.pi * n * along / reach, rest, smooth) / total for n in _WAVES]
    most = int(np.argmax(shares))
    return Wave(name, float(reach / _WAVES[most]), unit, float(shares[most]))


def _explained(phase: Array, rest: Array, smooth: Array) -> float:
    wave = np.column_stack([np.sin(phase), np.cos(phase)])
    across, _ = np.linalg.qr(wave - smooth @ (smooth.T @ wave))
    return float(((across.T @ rest) ** 2).sum())


def _smooth(command: Array) -> Array:
    """Orthonormal columns that span the polynomials of second degree."""
    count = command.shape[1]
    products = [
        command[:, i] * command[:, j] for i, j in combinations_with_replacement(range(count), 2)
    ]
    columns = np.column_stack([np.ones(len(command)), command, *products])
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(left[:, size > 1e-9 * size[0]])
