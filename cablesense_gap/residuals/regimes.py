"""The regimes in which a gap is clearly larger than elsewhere."""

from __future__ import annotations

import numpy as np

from cablesense_gap.residuals.decomposition import LOOP, Decomposition
from cablesense_gap.residuals.part import Part
from cablesense_gap.residuals.row_groups import (
    BRANCH,
    JOINT,
    LEVEL,
    LOADED,
    MOTION,
    POSE,
    REGIMES,
    TIME,
)

EVERYWHERE = "everywhere alike"
LARGER = 1.4
"""How many times the RMS of the rest of its group a regime must have: twice the mean square."""
ABOVE_FLOORS = 2.0
FEWEST_ROWS = 20
"""Four seconds at 5 Hz; what is shorter can be large by chance."""

_WORDS = {
    LOADED: "load on {}",
    POSE: "{} poses",
    JOINT: "{} bent most",
    LEVEL: "loads {}",
    BRANCH: "{}",
    MOTION: "{}",
    TIME: "{} in the recording",
    LOOP: "loading against unloading",
}


def regimes(decomposition: Decomposition) -> list[str]:
    """Regimes in plain words, the largest gap first; none where all is within the floor.

    Where a gap is there and no regime stands out, `EVERYWHERE`.
    """
    clear = [part for group in REGIMES for part in _standing_out(decomposition, group)]
    clear += [p for p in decomposition.of_group(LOOP) if p.over_floor >= ABOVE_FLOORS]
    if not clear and decomposition.rms_n >= ABOVE_FLOORS * decomposition.floor_n:
        return [EVERYWHERE]
    return [_words(part) for part in sorted(clear, key=lambda part: -part.rms_n)]


def _standing_out(decomposition: Decomposition, group: str) -> list[Part]:
    parts = decomposition.of_group(group)
    return [
        part
        for part in parts
        if len(parts) > 1 and _stands_out(part, [other for other in parts if other is not part])
    ]


def _stands_out(part: Part, others: list[Part]) -> bool:
    count = np.array([other.count for other in others])
    square = np.array([other.rms_n for other in others]) ** 2
    elsewhere_n = float(np.sqrt((count * square).sum() / count.sum()))
    return (
        part.count >= FEWEST_ROWS
        and part.over_floor >= ABOVE_FLOORS
        and part.rms_n >= LARGER * elsewhere_n
    )


def _words(part: Part) -> str:
    if part.member == "no load":
        return part.member
    return _WORDS[part.group].format(part.member.replace("_", " "))
