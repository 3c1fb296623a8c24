"""Patterns of a residual, in sentences for someone who seeks the cause at the arm.

Besides its parts (`residuals`): waves along a joint's angle or a cable's length, which screws,
gears and notches make and nothing that is smooth in the pose does; and what is sudden, one lasting
step of a channel or jumps while nothing is done.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import NamedTuple

import numpy as np

from cablesense_base import Array
from cablesense_gap.diagnosis.discrepancy import Discrepancy
from cablesense_gap.recordings.recording import Recording
from cablesense_gap.residuals import CABLE, LEVEL, LOOP, MODES, SET, Decomposition, decompose
from cablesense_gap.verdict import listed
from cablesense_sim.arm import Arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import held_lengths_m

_FEWEST_ROWS = 100
_LEAST_SHARE = 0.25
_AS_GOOD = 0.7
"""The waves of all cables together can follow that of one joint, which is the simpler."""
_WAVE_FLOORS = 1.5
_WAVES = np.arange(2.5, 20.0, 0.2)
"""Periods that a range of motion may hold; slower waves count as smooth."""

_STEP_SHARE = 0.6
"""Of a channel's scatter, that one step must explain."""
_STEP_FLOORS = 4.0
_EDGE = 0.05
"""Share of the rows at either end where a step cannot be distinguished from a few rows."""
_JUMP_FLOORS = 8.0
_FEWEST_JUMPS = 2
_AFTERMATH = 0.25
"""What goes on in the same direction by more than this share is no jump, but late."""

_WITHIN_FLOORS = 1.2
_MOST_OF_IT = 0.8
_ALIKE, _AGAINST = 1.8, 0.3
"""Times the share of the common mode that chance would give, one over the cables of a segment."""
_SELF_STRESS = 0.6
"""Share of the square, from which the rest is secondary."""
_LOOP_SHARE = 0.4
_GROWS = 2.0
_GOES_WITH, _REPEATS = 0.3, 0.2

_GROUPS = {
    "pose": "the commanded pose",
    "load": "the applied load",
    "tension": "the cables' tensions",
    "motion": "the direction in which cables move",
    "history": "where tensions last turned back",
    "time": "time",
}


class Wave(NamedTuple):
    """A residual that repeats along a joint angle (rad) or along cable lengths (m).

    `along` is the joint angle, or the cable that has most of it, `share` is of what is not smooth
    in the pose, beyond what a wave of any period explains.
    """

    along: str
    period: float
    unit: str
    share: float


def periodic(recording: Recording, residual_n: Array, floor_n: float, arm: Arm) -> Wave | None:
    """The wave that explains most of a residual (R, M) without load; None where none stands out.

    What is smooth, a polynomial of second degree in all commands, is taken out first. A wave is
    sought in the readings of all cables: what one does, the arm passes on to the others. All
    cables share a period, as their screws are alike.
    """
    free = recording.load_segment == 0
    command, residual = recording.command_rad[free], residual_n[free]
    moving = np.ptp(command, axis=0) > 0.0 if len(command) else np.zeros(0, dtype=bool)
    if len(command) < _FEWEST_ROWS or not moving.any():
        return None
    # orthonormal columns that span the polynomials of second degree
    moved = command[:, moving]
    products = [one * other for one, other in combinations_with_replacement(moved.T, 2)]
    columns = np.column_stack([np.ones(len(moved)), moved, *products])
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    smooth = left[:, size > 1e-9 * size[0]]
    rest = residual - smooth @ (smooth.T @ residual)
    if np.sqrt((rest**2).mean()) < _WAVE_FLOORS * floor_n:
        return None
    joints = [
        _wave((name,), "rad", angle[:, None], rest, smooth)
        for name, angle in zip(arm.joint_names, command.T, strict=True)
        if np.ptp(angle) > 0.0
    ]
    held_m = held_lengths_m(mechanism_of(arm), command)
    cables = _wave(arm.cable_names, "m", held_m, rest, smooth)
    joint = max(joints, key=lambda wave: wave.share)
    best = joint if joint.share >= _AS_GOOD * cables.share else cables
    return best if best.share >= _LEAST_SHARE else None


def _wave(names: Sequence[str], unit: str, along: Array, rest: Array, smooth: Array) -> Wave:
    """The best of one period for all of the coordinates (R, K), and which has most of it."""
    periods = float(np.ptp(along, axis=0).max()) / _WAVES
    total = float((rest**2).sum())
    shares = [_explained(along / each, rest, smooth) / total for each in periods]
    period = float(periods[int(np.argmax(shares))])
    alone = [_explained(column[:, None] / period, rest, smooth) for column in along.T]
    beyond_any = float(max(shares) - np.median(shares))
    return Wave(names[int(np.argmax(alone))], period, unit, beyond_any)


def _explained(turns: Array, rest: Array, smooth: Array) -> float:
    """Squares that waves of these turns (R, K) explain beside what is smooth."""
    wave = np.concatenate([np.sin(2.0 * np.pi * turns), np.cos(2.0 * np.pi * turns)], axis=1)
    left, size, _ = np.linalg.svd(wave - smooth @ (smooth.T @ wave), full_matrices=False)
    across = left[:, size > 1e-6 * np.sqrt(len(wave))]
    return float(((across.T @ rest) ** 2).sum())


class Step(NamedTuple):
    """A channel that changed once and stayed."""

    channel: int
    time_s: float
    size_n: float


@dataclass(frozen=True)
class Jumps:
    """Jumps of one channel between rows of one command and one load."""

    channel: int
    count: int
    size_n: float


def steps(recording: Recording, residual_n: Array, floor_n: float) -> tuple[Step, ...]:
    """Channels of a residual (R, M) whose scatter is one step in time, the largest first."""
    rows = np.arange(1, len(residual_n))
    centred = residual_n - residual_n.mean(0)
    before = np.cumsum(centred, axis=0)[:-1]
    weight = (rows * (len(residual_n) - rows) / len(residual_n))[:, None]
    apart = -before * len(residual_n) / (rows * (len(residual_n) - rows))[:, None]
    explained = weight * apart**2 / np.maximum((centred**2).sum(0), 1e-12)
    inside = (rows > _EDGE * len(residual_n)) & (rows < (1.0 - _EDGE) * len(residual_n))
    explained[~inside] = 0.0
    at = explained.argmax(0)
    found = [
        Step(c, float(recording.time_s[row + 1]), float(apart[row, c]))
        for c, row in enumerate(at.tolist())
        if explained[row, c] >= _STEP_SHARE and abs(apart[row, c]) >= _STEP_FLOORS * floor_n
    ]
    return tuple(sorted(found, key=lambda step: -abs(step.size_n)))


def jumps(recording: Recording, residual_n: Array, floor_n: float) -> tuple[Jumps, ...]:
    """Channels of a residual (R, M) that jump while nothing is done, most jumps first."""
    state = np.concatenate([recording.command_rad, recording.load_n], axis=1)
    still = (np.diff(state, axis=0) == 0.0).all(1) & (np.diff(recording.trial) == 0)
    change = np.pad(np.diff(residual_n, axis=0), ((1, 1), (0, 0)))
    here, size = change[1:-1], np.abs(change[1:-1])
    beside = np.stack([change[:-2], change[2:]])
    goes_on = (np.sign(beside) == np.sign(here)) & (np.abs(beside) > _AFTERMATH * size)
    settled = still & np.append(False, still[:-1])
    far = settled[:, None] & (size > _JUMP_FLOORS * floor_n) & ~goes_on.any(0)
    found = [
        Jumps(c, int(far[:, c].sum()), float(np.median(size[far[:, c], c])))
        for c in range(residual_n.shape[1])
        if far[:, c].sum() >= _FEWEST_JUMPS
    ]
    return tuple(sorted(found, key=lambda each: -each.count))


def residual_patterns(
    recording: Recording, residual_n: Array, found: Discrepancy, arm: Arm, floor_n: float
) -> tuple[str, ...]:
    """Where a residual (R, M) is and how it behaves; nothing where it is within the floor.

    `recording` and the residual hold the rows that count; `found` is the flexible model of it.

    Raises:
        ValueError: the residual is of other shape than the readings.
    """
    parts = decompose(recording, residual_n, floor_n, arm)
    if parts.rms_n < _WITHIN_FLOORS * floor_n:
        return ()
    return (
        _cables(parts),
        *_modes(parts, arm.cables.per_segment),
        *_goes_with(found),
        *_with_load(parts),
        *_waves(recording, residual_n, floor_n, arm),
        *_sudden(recording, residual_n, floor_n, arm),
    )


def _cables(parts: Decomposition) -> str:
    """The fewest cables that hold most of it, if these are few."""
    ranked = sorted(parts.of_group(CABLE), key=lambda part: -part.rms_n)
    square = np.array([part.rms_n for part in ranked]) ** 2
    few = int(np.searchsorted(np.cumsum(square), _MOST_OF_IT * square.sum())) + 1
    if few > len(ranked) // 3:
        return (
            f"It is in all cables: {ranked[-1].rms_n:.2g} to {ranked[0].rms_n:.2g} N RMS, with a "
            f"noise floor of {parts.floor_n:.2g} N."
        )
    numbers = [f"{_plain(p.member)} ({p.rms_n:.2g} N RMS)" for p in ranked[:few]]
    share = square[:few].sum() / square.sum()
    return f"{share:.0%} of its square is in {listed(numbers)}."


def _modes(parts: Decomposition, cable_count: int) -> Iterator[str]:
    """How the cables of one segment change together."""
    square = dict.fromkeys(MODES, 0.0)
    for part in parts.of_group(SET):
        mode = next(mode for mode in MODES if part.member.endswith(mode))
        columns = cable_count - len(MODES) + 1 if mode == MODES[-1] else 1
        square[mode] += columns * part.rms_n**2
    total, chance = max(sum(square.values()), 1e-12), 1.0 / cable_count
    common, self_stress = square[MODES[0]] / total, square[MODES[-1]] / total
    if common >= _ALIKE * chance:
        yield "The cables that end on one segment change alike, as pretension and length would."
    elif self_stress >= _SELF_STRESS:
        yield (
            "The cables that end on one segment change against each other without a torque on "
            "the segment, as cables that are tensioned or measured differently would."
        )
    elif common <= _AGAINST * chance:
        yield (
            "The cables that end on one segment change against each other, as a torque on the "
            "segment would make them."
        )


def _goes_with(found: Discrepancy) -> Iterator[str]:
    group, share = max(found.alone.items(), key=lambda item: item[1], default=("", 0.0))
    if share >= _GOES_WITH:
        first = f", most plainly with {_plain(found.foremost[0])}" if found.foremost else ""
        yield (
            f"It goes with {_GROUPS.get(group, group)}: that alone predicts {share:.0%} of it "
            f"where a flexible model was not fitted{first}."
        )
    elif found.explained_share < _REPEATS:
        yield (
            "It does not repeat itself: where a flexible model was not fitted, it predicts "
            f"{max(found.explained_share, 0.0):.0%} of it. Chance events, or a pose or load that "
            "occurs only once, have this pattern."
        )


def _with_load(parts: Decomposition) -> Iterator[str]:
    levels = parts.of_group(LEVEL)
    if len(levels) > 1 and levels[-1].rms_n >= _GROWS * levels[0].rms_n:
        items = [f"{p.rms_n:.2g} N RMS for loads {p.member}" for p in levels]
        yield f"It grows with the load: {listed(items)}."
    for loop in parts.of_group(LOOP):
        if loop.rms_n >= max(_LOOP_SHARE * parts.rms_n, _WITHIN_FLOORS * parts.floor_n):
            yield (
                f"Loading and unloading differ, by {2.0 * loop.rms_n:.2g} N RMS at one load: it "
                "is history-dependent, as friction, play and creep are."
            )


def _waves(recording: Recording, residual_n: Array, floor_n: float, arm: Arm) -> Iterator[str]:
    wave = periodic(recording, residual_n, floor_n, arm)
    if wave is not None and wave.unit == "rad":
        yield (
            f"It repeats every {np.rad2deg(wave.period):.2g} degrees of "
            f"{_plain(wave.along)}, as teeth or notches would make it."
        )
    elif wave is not None:
        yield (
            f"It repeats every {1e3 * wave.period:.2g} mm of cable, most in {_plain(wave.along)}, "
            "as a screw, a gear or a drum would make it."
        )


def _sudden(recording: Recording, residual_n: Array, floor_n: float, arm: Arm) -> Iterator[str]:
    names = [_plain(name) for name in arm.cable_names]
    found = steps(recording, residual_n, floor_n)
    if found:
        items = [f"{names[s.channel]} by {s.size_n:+.2g} N at {s.time_s:.0f} s" for s in found[:3]]
        yield f"It comes at once and stays: {listed(items)}. See what slipped or was moved then."
    often = jumps(recording, residual_n, floor_n)
    if often:
        items = [f"{j.count} times in {names[j.channel]} (by {j.size_n:.2g} N)" for j in often[:3]]
        yield (
            f"It jumps while nothing moves: {listed(items)}. Look at sensors, their wiring and "
            "their electronics, and for what snaps or sticks."
        )


def _plain(name: str) -> str:
    return name.replace("_", " ")
