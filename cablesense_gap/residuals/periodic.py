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
"""Of what is not smooth in the pose, beyond what a wave of any period explains."""
AS_GOOD = 0.7
"""The waves of all cables together can follow that of one joint, which is the simpler."""
ABOVE_FLOORS = 1.5
_WAVES = np.arange(2.5, 20.0, 0.2)
"""Periods that a range of motion may hold; slower waves cannot be told from what is smooth."""


@dataclass(frozen=True)
class Wave:
    """What repeats.

    Attributes:
        along: the joint angle, or the cable that has most of it, by name.
        period: in `unit`.
        unit: `rad` or `m`.
        share: of what is not smooth in the pose, beyond what a wave of any period explains.
    """

    along: str
    period: float
    unit: str
    share: float


def periodic(recording: Recording, residual_n: Array, floor_n: float, arm: Arm) -> Wave | None:
    """The wave that explains most of a residual (R, M) without load; None where none stands out.

    A wave is sought in the readings of all cables: what one does, the arm passes on to the others.
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
    total = float((rest**2).sum())
    found = [
        _of_joint(name, angle, rest, smooth, total)
        for name, angle in zip(arm.joint_names, command.T, strict=True)
        if np.ptp(angle) > 0.0
    ]
    held_m = held_lengths_m(Mechanism.from_arm(arm), command)
    cables = _of_cables(arm.cable_names, held_m, rest, smooth, total)
    joint = max(found, key=lambda wave: wave.share)
    best = joint if joint.share >= AS_GOOD * cables.share else cables
    return best if best.share >= LEAST_SHARE else None


def _of_joint(name: str, angle: Array, rest: Array, smooth: Array, total: float) -> Wave:
    periods = float(np.ptp(angle)) / _WAVES
    shares = [_explained(angle[:, None] / each, rest, smooth) / total for each in periods]
    most = int(np.argmax(shares))
    return Wave(name, float(periods[most]), "rad", _beyond_any(shares))


def _of_cables(
    names: tuple[str, ...], held_m: Array, rest: Array, smooth: Array, total: float
) -> Wave:
    """One period for all cables, as their screws are alike, and the cable that has most of it."""
    periods = float(np.ptp(held_m, axis=0).max()) / _WAVES
    shares = [_explained(held_m / each, rest, smooth) / total for each in periods]
    most = int(np.argmax(shares))
    alone = [_explained(length[:, None] / periods[most], rest, smooth) for length in held_m.T]
    return Wave(names[int(np.argmax(alone))], float(periods[most]), "m", _beyond_any(shares))


def _beyond_any(shares: list[float]) -> float:
    return float(max(shares) - np.median(shares))


def _explained(turns: Array, rest: Array, smooth: Array) -> float:
    """Squares that waves of these turns (R, K) explain beside what is smooth."""
    wave = np.concatenate([np.sin(2.0 * np.pi * turns), np.cos(2.0 * np.pi * turns)], axis=1)
    left, size, _ = np.linalg.svd(wave - smooth @ (smooth.T @ wave), full_matrices=False)
    across = left[:, size > 1e-6 * np.sqrt(len(wave))]
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
