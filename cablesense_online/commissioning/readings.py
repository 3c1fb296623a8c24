"""Readings of all sensors over some time, wherever from, and when the arm was at rest.

A stretch of a recording in which something known was done to one cable.

Tables that people write by hand: a CSV file of a few columns and at most some thousand rows.

The error of a commissioning that cannot be done with what was given.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cablesense_base.arrays import Array
from cablesense_base.errors import CableSenseError
from cablesense_base.files import read_bounded_text
from cablesense_gap.recordings.recording import Recording

SETTLING_S = 1.0
"""How long after a change of pose or load the arm still swings."""


@dataclass(frozen=True)
class TensionSeries:
    """R readings of M sensors in time order.

    Attributes:
        cable_names: (M,).
        time_s: (R,) ascending.
        block: (R,) rows of one block follow each other without a wanted break.
        at_rest: (R,) whether the arm stood in one and the same pose with nothing touching it.
        tensions_n: (R, M).
        problems: what was already wrong when the readings came, a line each.
    """

    cable_names: tuple[str, ...]
    time_s: Array
    block: NDArray[np.int64]
    at_rest: NDArray[np.bool_]
    tensions_n: Array
    problems: tuple[str, ...] = ()

    @property
    def duration_s(self) -> float:
        """From the first reading to the last."""
        return float(self.time_s[-1] - self.time_s[0])


def series_of(recording: Recording, cable_names: tuple[str, ...]) -> TensionSeries:
    """A recording's readings; at rest is its most frequent pose without a load, once settled."""
    unloaded = recording.load_segment == 0
    at_rest = np.zeros(len(recording), dtype=bool)
    if unloaded.any():
        poses, number = np.unique(recording.command_rad, axis=0, return_inverse=True)
        number = number.reshape(-1)
        usual = int(np.bincount(number[unloaded], minlength=len(poses)).argmax())
        at_rest = unloaded & (number == usual)
    changed = np.concatenate([[False], np.diff(at_rest.astype(int)) == 1])
    for start_s in recording.time_s[changed].tolist():
        since_s = recording.time_s - start_s
        at_rest &= ~((since_s >= 0.0) & (since_s < SETTLING_S))
    return TensionSeries(
        cable_names, recording.time_s, recording.trial, at_rest, recording.tensions_n
    )


def without(series: TensionSeries, start_s: float, end_s: float) -> NDArray[np.bool_]:
    """(R,) at rest, and not from `start_s` to `end_s`, nor while the arm then settles."""
    touched = (series.time_s >= start_s) & (series.time_s <= end_s + SETTLING_S)
    return series.at_rest & ~touched


class CommissioningError(CableSenseError):
    """What was given cannot be used: names file, row or cable, and what would be right."""


MAX_TABLE_BYTES = 1_000_000
"""Far more rows than anybody writes."""


@dataclass(frozen=True)
class TableRow:
    """One row; `where` names file and row in errors, `cells` go by column."""

    where: str
    cells: Mapping[str, str]

    def text(self, column: str) -> str:
        """The text of a cell.

        Raises:
            CommissioningError: it is empty.
        """
        if not self.cells.get(column):
            raise CommissioningError(f"{self.where}: {column} is empty")
        return self.cells[column]

    def number(self, column: str, lowest: float, highest: float) -> float:
        """The number in a cell.

        Raises:
            CommissioningError: it is empty, no number, or out of range.
        """
        written = self.text(column)
        try:
            value = float(written)
        except ValueError:
            value = float("nan")
        if not (isfinite(value) and lowest <= value <= highest):
            raise CommissioningError(
                f"{self.where}: {column} is {written[:40]!r}; it must be a number from "
                f"{lowest:g} to {highest:g}"
            )
        return value


def read_table(
    path: str | Path, required: Sequence[str], optional: Sequence[str]
) -> list[TableRow]:
    """Read a table; empty lines and lines that begin with # are left out.

    Raises:
        CommissioningError: no file, too large, no text, a column missing, unknown or
            twice, a row with more or fewer cells than the header, or no rows.
    """
    text = read_bounded_text(path, MAX_TABLE_BYTES, "a table written by hand", CommissioningError)
    lines = [
        (number, line)
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    try:
        rows = [(number, next(csv.reader([line]), [])) for number, line in lines]
    except csv.Error as error:
        raise CommissioningError(f"{path}: cannot be read as CSV ({error})") from error
    known = [*required, *optional]
    if not rows:
        raise CommissioningError(f"{path}: is empty; its first line must be {','.join(known)}")
    header = [name.strip() for name in rows[0][1]]
    missing = [name for name in required if name not in header]
    unknown = [name for name in header if name not in known]
    if missing or unknown or len(set(header)) < len(header):
        found = [f"misses {', '.join(missing)}"] if missing else []
        found += [f"has {', '.join(unknown)[:80]}"] if unknown else []
        raise CommissioningError(
            f"{path}: the header {' and '.join(found) or 'has a column twice'}; it must have "
            f"{', '.join(required)}, and may have {', '.join(optional) or 'nothing else'}"
        )
    made = []
    for number, cells in rows[1:]:
        if len(cells) != len(header):
            raise CommissioningError(
                f"{path}: line {number} has {len(cells)} cells, the header {len(header)}"
            )
        stripped = {name: cell.strip() for name, cell in zip(header, cells, strict=True)}
        made.append(TableRow(f"{path}: line {number}", stripped))
    if not made:
        raise CommissioningError(f"{path}: has a header and no rows")
    return made


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
