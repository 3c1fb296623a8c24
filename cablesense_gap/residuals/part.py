"""One part of a residual, measured beside the noise floor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Part:
    """The residual in one member of a group.

    Attributes:
        group: by what the residual is taken apart.
        member: which of that; a place by its name, a regime in plain words.
        rms_n: root mean square.
        over_floor: the same in noise floors.
        mean_n: signed mean over all its numbers.
        systematic_share: of the mean square, what one constant per channel explains; the rest
            scatters within the member.
        count: rows in it.
    """

    group: str
    member: str
    rms_n: float
    over_floor: float
    mean_n: float
    systematic_share: float
    count: int


def measure(group: str, member: str, values_n: Array, floor_n: float) -> Part | None:
    """Measure values (R, C) in N, NaN where a number is missing; None where all are."""
    known = np.isfinite(values_n)
    count = known.sum(axis=0)
    if not count.any():
        return None
    seen = count > 0
    known, values_n, count = known[:, seen], values_n[:, seen], count[seen]
    filled = np.where(known, values_n, 0.0)
    square, mean = (filled**2).sum(axis=0), filled.sum(axis=0) / count
    total = float(square.sum())
    rms_n = float(np.sqrt(total / count.sum()))
    return Part(
        group=group,
        member=member,
        rms_n=rms_n,
        over_floor=rms_n / floor_n if floor_n > 0.0 else np.inf,
        mean_n=float(filled.sum() / count.sum()),
        systematic_share=float((count * mean**2).sum()) / total if total > 0.0 else 0.0,
        count=int(known.any(axis=1).sum()),
    )
