"""What a residual looks like, in sentences for someone who seeks the cause at the arm."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.diagnosis.discrepancy import Discrepancy
from cablesense_gap.recordings.recording import Recording
from cablesense_gap.residuals.cable_sets import MODES
from cablesense_gap.residuals.decomposition import CABLE, LOOP, SET, Decomposition, decompose
from cablesense_gap.residuals.periodic import periodic
from cablesense_gap.residuals.row_groups import LEVEL
from cablesense_gap.residuals.sudden import jumps, steps
from cablesense_sim.arm import Arm

Array = NDArray[np.float64]

WITHIN_FLOORS = 1.2
MOST_OF_IT = 0.8
ALIKE, AGAINST = 0.6, 0.9
"""Shares of common mode and of bending; by chance these would be 0.33 and 0.67."""
LOOP_SHARE = 0.4
GROWS = 2.0
GOES_WITH, REPEATS = 0.3, 0.2

_GROUPS = {
    "pose": "the commanded pose",
    "load": "the applied load",
    "tension": "the cables' tensions",
    "motion": "the direction in which cables move",
    "history": "where tensions last turned back",
    "time": "time",
}


def looks_like(
    recording: Recording, residual_n: Array, found: Discrepancy, arm: Arm, floor_n: float
) -> tuple[str, ...]:
    """Where a residual (R, M) is and how it behaves; nothing where it is within the floor.

    `recording` and the residual hold the rows that count; `found` is the flexible model of it.

    Raises:
        ValueError: the residual is of other shape than the readings.
    """
    parts = decompose(recording, residual_n, floor_n, arm)
    if parts.rms_n < WITHIN_FLOORS * floor_n:
        return ()
    return (
        _cables(parts),
        *_modes(parts),
        *_goes_with(found),
        *_grows(parts),
        *_loop(parts),
        *_waves(recording, residual_n, floor_n, arm),
        *_sudden(recording, residual_n, floor_n, arm),
    )


def _cables(parts: Decomposition) -> str:
    """The fewest cables that hold most of it, if these are few."""
    ranked = sorted(parts.of_group(CABLE), key=lambda part: -part.rms_n)
    square = np.array([part.rms_n for part in ranked]) ** 2
    few = int(np.searchsorted(np.cumsum(square), MOST_OF_IT * square.sum())) + 1
    if few > len(ranked) // 3:
        return (
            f"It is in all cables: {ranked[-1].rms_n:.2g} to {ranked[0].rms_n:.2g} N RMS, with a "
            f"noise floor of {parts.floor_n:.2g} N."
        )
    numbers = [f"{_plain(p.member)} ({p.rms_n:.2g} N RMS)" for p in ranked[:few]]
    share = square[:few].sum() / square.sum()
    return f"{share:.0%} of its square is in {_and(numbers)}."


def _modes(parts: Decomposition) -> Iterator[str]:
    """How the cables of a set go together."""
    square = {
        mode: sum(p.rms_n**2 for p in parts.of_group(SET) if p.member.endswith(mode))
        for mode in MODES
    }
    common = square[MODES[0]] / max(sum(square.values()), 1e-12)
    if common >= ALIKE:
        yield "The cables that end on one segment change alike, as pretension and length would."
    elif 1.0 - common >= AGAINST:
        yield (
            "The cables that end on one segment change against each other, as a torque on the "
            "segment would make them."
        )


def _goes_with(found: Discrepancy) -> Iterator[str]:
    group, share = max(found.alone.items(), key=lambda item: item[1], default=("", 0.0))
    if share >= GOES_WITH:
        first = f", most plainly with {_plain(found.foremost[0])}" if found.foremost else ""
        yield (
            f"It goes with {_GROUPS.get(group, group)}: that alone predicts {share:.0%} of it "
            f"where a flexible model was not fitted{first}."
        )
    elif found.explained_share < REPEATS:
        yield (
            "It does not repeat itself: where a flexible model was not fitted, it predicts "
            f"{max(found.explained_share, 0.0):.0%} of it. Chance events, or a pose or load that "
            "occurs only once, look like this."
        )


def _grows(parts: Decomposition) -> Iterator[str]:
    levels = parts.of_group(LEVEL)
    if len(levels) > 1 and levels[-1].rms_n >= GROWS * levels[0].rms_n:
        listed = [f"{p.rms_n:.2g} N RMS for loads {p.member}" for p in levels]
        yield f"It grows with the load: {_and(listed)}."


def _loop(parts: Decomposition) -> Iterator[str]:
    for loop in parts.of_group(LOOP):
        if loop.rms_n >= max(LOOP_SHARE * parts.rms_n, WITHIN_FLOORS * parts.floor_n):
            yield (
                f"Loading and unloading differ, by {2.0 * loop.rms_n:.2g} N RMS at one load: it "
                "remembers, as friction, play and creep do."
            )


def _waves(recording: Recording, residual_n: Array, floor_n: float, arm: Arm) -> Iterator[str]:
    wave = periodic(recording, residual_n, floor_n, arm)
    if wave is None:
        return
    if wave.unit == "rad":
        yield (
            f"It repeats every {np.rad2deg(wave.period):.2g} degrees of "
            f"{_plain(wave.along)}, as teeth or notches would make it."
        )
    else:
        yield (
            f"It repeats every {1e3 * wave.period:.2g} mm of cable, most in {_plain(wave.along)}, "
            "as a screw, a gear or a drum would make it."
        )


def _sudden(recording: Recording, residual_n: Array, floor_n: float, arm: Arm) -> Iterator[str]:
    names = [_plain(name) for name in arm.cable_names]
    found = steps(recording, residual_n, floor_n)
    if found:
        listed = [
            f"{names[s.channel]} by {s.size_n:+.2g} N at {s.time_s:.0f} s" for s in found[:3]
        ]
        yield (
            f"It comes at once and stays: {_and(listed)}. Look for what slipped or was moved then."
        )
    often = jumps(recording, residual_n, floor_n)
    if often:
        listed = [
            f"{j.count} times in {names[j.channel]} (by {j.size_n:.2g} N)" for j in often[:3]
        ]
        yield (
            f"It jumps while nothing moves: {_and(listed)}. Look at sensors, their wiring and "
            "their electronics, and for what snaps or sticks."
        )


def _plain(name: str) -> str:
    return name.replace("_", " ")


def _and(items: list[str]) -> str:
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} and {items[-1]}"
