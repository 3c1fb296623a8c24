"""Rows as people count them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_SHOWN = 5


def rows_named(wrong: NDArray[Any]) -> str:
    """Marked rows (R,), from 1: `row 7`, `rows 3 to 9 and 12`, `rows 1, 3 … (40 in all)`."""
    rows = np.flatnonzero(wrong) + 1
    if len(rows) == 1:
        return f"row {rows[0]}"
    runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    named = [f"{run[0]} to {run[-1]}" if len(run) > 1 else f"{run[0]}" for run in runs]
    if len(named) > _SHOWN:
        return f"rows {', '.join(named[:_SHOWN])} … ({len(rows)} in all)"
    *first, last = named
    return f"rows {', '.join(first)} and {last}" if first else f"rows {last}"
