"""A stretch of a recording in which something known was done to one cable."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cablesense_ros.commissioning.commissioning_error import CommissioningError
from cablesense_ros.commissioning.small_table import TableRow

LATEST_S = 1e7
"""A hundred days; beyond it a time is a date."""


@dataclass(frozen=True)
class TimeWindow:
    """From `start_s` to `end_s` of a recording's time."""

    start_s: float
    end_s: float

    def rows(self, time_s: NDArray[np.float64]) -> NDArray[np.bool_]:
        """(R,) which of the rows at `time_s` (R,) lie within."""
        return (time_s >= self.start_s) & (time_s <= self.end_s)


def window_of(row: TableRow) -> TimeWindow:
    """The window that a row's `start_s` and `end_s` say.

    Raises:
        CommissioningError: either is no time, or the end is not after the start.
    """
    start_s = row.number("start_s", 0.0, LATEST_S)
    end_s = row.number("end_s", 0.0, LATEST_S)
    if end_s <= start_s:
        raise CommissioningError(
            f"{row.where}: end_s = {end_s:g} is not after start_s = {start_s:g}"
        )
    return TimeWindow(start_s, end_s)
