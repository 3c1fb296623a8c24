"""Arms with effects, and courses to put them through, for the tests of effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.course import Course
from cablesense_sim.effects.registry import EffectEntry, checked_entry
from cablesense_sim.replay import Replay

ARM = open_arm("cdsm_lab")
MECHANISM = mechanism_of(ARM)
STRAIGHT = np.zeros(ARM.joint_count)


def entry(name: str, at: str = "arm", **values: float) -> EffectEntry:
    """An effect on the laboratory arm."""
    return checked_entry(name, at, values, ARM.segment_count, ARM.cable_count)


def push(segment: int, force_n: Sequence[float]) -> np.ndarray:
    """Loads (4, 3) with one force in base axes."""
    loads = np.zeros((ARM.segment_count, 3))
    loads[segment - 1] = force_n
    return loads


def bent(seed: int = 0, most_deg: float = 8.0, count: int | None = None) -> np.ndarray:
    """Commands (8,) or (count, 8) that leave every cable taut."""
    rng = np.random.default_rng(seed)
    size = ARM.joint_count if count is None else (count, ARM.joint_count)
    return np.deg2rad(rng.uniform(-most_deg, most_deg, size))


def course(commands: np.ndarray, loads: np.ndarray, period_s: float = 0.2) -> Replay:
    """Commands (R, 8) or (8,) and loads (R, 4, 3) or (4, 3), one every `period_s`."""
    commands = np.atleast_2d(commands)
    loads = np.reshape(loads, (-1, *loads.shape[-2:]))
    rows = max(len(commands), len(loads))
    return Replay(
        ARM,
        Course(
            period_s * np.arange(rows),
            np.broadcast_to(commands, (rows, ARM.joint_count)).copy(),
            np.broadcast_to(loads, (rows, ARM.segment_count, 3)).copy(),
        ),
    )


def readings(replay: Replay, *entries: EffectEntry) -> np.ndarray:
    """Readings (R, 12) of one arm."""
    return replay.readings_n([list(entries)])[0]


def up_and_down(highest_n: float = 15.0, rows: int = 12, segment: int = 3) -> np.ndarray:
    """Loads (2 rows + 1, 4, 3) along y: from nothing up, and down again by the same steps."""
    rise = np.linspace(0.0, highest_n, rows + 1)
    return np.stack([push(segment, [0.0, f, 0.0]) for f in [*rise, *rise[-2::-1]]])


def small(entry_: EffectEntry, **values: float) -> EffectEntry:
    """The same entry with other values."""
    merged: Mapping[str, float] = {**entry_.values, **values}
    return EffectEntry(entry_.effect, entry_.place, dict(merged))
