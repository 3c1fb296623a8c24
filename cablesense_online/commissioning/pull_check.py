"""Cables pulled by hand, one at a time: the channel that moves most must be the pulled cable's.

A pull on one cable bends the arm and so moves others as well, hence two are told apart only where
one moves clearly more. Pulled sideways between its sensor and the arm, the pulled one does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cablesense_online.commissioning.readings import (
    CommissioningError,
    TensionSeries,
    TimeWindow,
    read_table,
    window_of,
)

BEFORE_S = 1.0
"""What a pull is compared with: the time just before."""
FEWEST_SAMPLES = 3
CLEARLY = 0.7
"""Where the second channel moves by more than this share of the first, nothing is told."""
PULLED_FLOORS = 10.0
"""A pull counts from so many standard deviations of the readings on."""


class PullVerdict(StrEnum):
    """What a pull showed."""

    RIGHT = "right"
    SWAPPED = "swapped"
    DEAD = "dead"
    UNCLEAR = "unclear"
    TOO_WEAK = "too weak"


@dataclass(frozen=True)
class Pull:
    """Which cable was pulled, and when."""

    cable: str
    window: TimeWindow


@dataclass(frozen=True)
class PullResult:
    """What a pull showed.

    Attributes:
        cable: which was pulled.
        moved: the channel that moved most, and `second` the next.
        own_n, moved_n, second_n: by how much the pulled cable's channel and those two moved.
        verdict: what follows.
    """

    cable: str
    own_n: float
    moved: str
    moved_n: float
    second: str
    second_n: float
    verdict: PullVerdict


def read_pulls(path: str | Path, cable_names: Sequence[str]) -> list[Pull]:
    """Pulls from a CSV with the columns `cable`, `start_s` and `end_s`.

    Raises:
        CableSenseError: the file cannot be read as such a table.
        CommissioningError: it names a cable that there is not.
    """
    pulls = []
    for row in read_table(path, ("cable", "start_s", "end_s"), ()):
        cable = row.text("cable")
        if cable not in cable_names:
            raise CommissioningError(
                f"{row.where}: no cable {cable[:40]!r}; there are {', '.join(cable_names)}"
            )
        pulls.append(Pull(cable, window_of(row)))
    return pulls


def judge_pull(series: TensionSeries, pull: Pull, floor_n: float) -> PullResult:
    """What a pull showed.

    Args:
        series: of two cables or more.
        pull: within its time.
        floor_n: standard deviation of readings at rest, as it should be.

    Raises:
        CommissioningError: too few readings before or during the pull.
    """
    moved_n = _movement_n(series, pull)
    ranked = np.argsort(moved_n)[::-1]
    first, second = int(ranked[0]), int(ranked[1])
    own = series.cable_names.index(pull.cable)
    if moved_n[first] < PULLED_FLOORS * floor_n:
        verdict = PullVerdict.TOO_WEAK
    elif first == own:
        clear = moved_n[second] <= CLEARLY * moved_n[first]
        verdict = PullVerdict.RIGHT if clear else PullVerdict.UNCLEAR
    elif np.ptp(series.tensions_n[pull.window.rows(series.time_s), own]) == 0.0:
        verdict = PullVerdict.DEAD
    else:
        clear = moved_n[own] <= CLEARLY * moved_n[first]
        verdict = PullVerdict.SWAPPED if clear else PullVerdict.UNCLEAR
    names = series.cable_names
    return PullResult(
        pull.cable,
        float(moved_n[own]),
        names[first],
        float(moved_n[first]),
        names[second],
        float(moved_n[second]),
        verdict,
    )


def _movement_n(series: TensionSeries, pull: Pull) -> NDArray[np.float64]:
    """(M,) from the median before to what a twentieth of the readings exceed."""
    start_s = pull.window.start_s
    before = (series.time_s >= start_s - BEFORE_S) & (series.time_s < start_s)
    during = pull.window.rows(series.time_s)
    if min(np.count_nonzero(before), np.count_nonzero(during)) < FEWEST_SAMPLES:
        raise CommissioningError(
            f"pull of {pull.cable} from {start_s:g} s: {np.count_nonzero(before)} readings in the "
            f"second before and {np.count_nonzero(during)} until {pull.window.end_s:g} s; at "
            f"least {FEWEST_SAMPLES} of each are needed"
        )
    rest_n = np.median(series.tensions_n[before], axis=0)
    moved_n = np.quantile(np.abs(series.tensions_n[during] - rest_n), 0.95, axis=0)
    return np.asarray(moved_n, dtype=np.float64)
