"""Tables written by hand: known loads on single cables, and pulls on single cables.

A table is a small CSV file. It is read by `csv` rather than pandas, so that errors name the line.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array, CableSenseError
from cablesense_base.files import read_bounded_text

STANDARD_GRAVITY_M_S2 = 9.80665
"""3rd CGPM (1901)."""
GRAVITY_RELATIVE_U = 0.0015
"""Standard uncertainty of the standard value where the local one is not given: normal gravity goes
from 9.7803 m/s² at the equator to 9.8322 at the poles (WGS 84); half of that over root 3."""
MAX_TABLE_BYTES = 1_000_000
"""Far more than a table written by hand."""
HEAVIEST_N = 20_000.0
LARGEST_RAW = 1e11
LATEST_S = 1e7
"""About a hundred days; a larger number is a date."""
_WINDOW_COLUMNS = ("start_s", "end_s")
_LOAD_COLUMNS = ("mass_kg", "mass_u_kg", "force_n", "force_u_n", "raw", "raw_u", *_WINDOW_COLUMNS)


class CommissioningError(CableSenseError):
    """Unusable input for commissioning; the message names file, row or cable, and the remedy."""


@dataclass(frozen=True)
class TimeWindow:
    """From `start_s` to `end_s` of a recording's time."""

    start_s: float
    end_s: float

    def rows(self, time_s: Array) -> NDArray[np.bool_]:
        """(R,) which of the rows at `time_s` (R,) lie within."""
        return (time_s >= self.start_s) & (time_s <= self.end_s)


@dataclass(frozen=True)
class KnownLoad:
    """One load on one cable.

    Attributes:
        where: file and row, for errors.
        cable: name of the loaded cable.
        by_mass: whether the force was computed from a mass and has the uncertainty of gravity.
        force_n: force on the cable.
        force_u_n: its standard uncertainty, without the part shared by all loads; 0 if unknown.
        reading: the sensor's reading in the signal's unit, or its window in a recording.
        raw_u: standard uncertainty of the reading; 0 if unknown.
    """

    where: str
    cable: str
    by_mass: bool
    force_n: float
    force_u_n: float
    reading: float | TimeWindow
    raw_u: float


@dataclass(frozen=True)
class Pull:
    """Which cable was pulled, and when."""

    cable: str
    window: TimeWindow


def read_known_loads(
    path: str | Path, cable_names: Sequence[str], gravity_m_s2: float = STANDARD_GRAVITY_M_S2
) -> dict[str, list[KnownLoad]]:
    """Known loads by cable, each in the order of application.

    Columns: `cable`; `mass_kg` or `force_n`; `raw`, or `start_s` and `end_s`; if known also
    `mass_u_kg` or `force_u_n`, and `raw_u`. A load of 0 is the bare cable.

    Raises:
        CableSenseError: the file cannot be read as such a table.
        CommissioningError: a row names no cable of `cable_names`, lacks load or reading, or has
            two of either.
    """
    loads: dict[str, list[KnownLoad]] = {}
    for row in _rows(path, ("cable",), _LOAD_COLUMNS):
        by_mass = row.one_of("mass_kg", "force_n") == "mass_kg"
        load, spread = ("mass_kg", "mass_u_kg") if by_mass else ("force_n", "force_u_n")
        newtons = gravity_m_s2 if by_mass else 1.0
        by_reading = row.one_of("raw", "start_s") == "raw"
        known = KnownLoad(
            where=row.where,
            cable=row.cable(cable_names),
            by_mass=by_mass,
            force_n=newtons * row.number(load, 0.0, HEAVIEST_N / newtons),
            force_u_n=newtons * row.number(spread, 0.0, LARGEST_RAW, missing=0.0),
            reading=row.number("raw", -LARGEST_RAW, LARGEST_RAW) if by_reading else row.window(),
            raw_u=row.number("raw_u", 0.0, LARGEST_RAW, missing=0.0),
        )
        loads.setdefault(known.cable, []).append(known)
    return loads


def read_pulls(path: str | Path, cable_names: Sequence[str]) -> list[Pull]:
    """Pulls from a CSV with the columns `cable`, `start_s` and `end_s`.

    Raises:
        CommissioningError: the file cannot be read as such a table, or names an unknown cable.
    """
    rows = _rows(path, ("cable", *_WINDOW_COLUMNS), ())
    return [Pull(row.cable(cable_names), row.window()) for row in rows]


@dataclass(frozen=True)
class _Row:
    """One row; `where` names file and row in errors, `cells` maps columns to texts."""

    where: str
    cells: Mapping[str, str]

    def text(self, column: str) -> str:
        if not self.cells.get(column):
            raise CommissioningError(f"{self.where}: {column} is empty")
        return self.cells[column]

    def number(
        self, column: str, lowest: float, highest: float, missing: float | None = None
    ) -> float:
        """The number in a cell; `missing`, if given, where the cell is empty."""
        if missing is not None and not self.cells.get(column):
            return missing
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

    def cable(self, cable_names: Sequence[str]) -> str:
        cable = self.text("cable")
        if cable not in cable_names:
            raise CommissioningError(
                f"{self.where}: no cable {cable[:40]!r}; there are {', '.join(cable_names)}"
            )
        return cable

    def window(self) -> TimeWindow:
        start_s = self.number("start_s", 0.0, LATEST_S)
        end_s = self.number("end_s", 0.0, LATEST_S)
        if end_s <= start_s:
            raise CommissioningError(
                f"{self.where}: end_s = {end_s:g} is not after start_s = {start_s:g}"
            )
        return TimeWindow(start_s, end_s)

    def one_of(self, first: str, second: str) -> str:
        given = [name for name in (first, second) if self.cells.get(name)]
        if len(given) != 1:
            raise CommissioningError(
                f"{self.where}: gives {'both' if given else 'neither'} {first} "
                f"{'and' if given else 'nor'} {second}; it must give one"
            )
        return given[0]


def _rows(path: str | Path, required: Sequence[str], optional: Sequence[str]) -> list[_Row]:
    """Read a table, without empty lines and lines that begin with #."""
    text = read_bounded_text(path, MAX_TABLE_BYTES, "a table written by hand", CommissioningError)
    lines = [
        (number, line)
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    try:
        rows = [
            (number, [cell.strip() for cell in next(csv.reader([line]), [])])
            for number, line in lines
        ]
    except csv.Error as error:
        raise CommissioningError(f"{path}: cannot be read as CSV ({error})") from error
    known = [*required, *optional]
    if not rows:
        raise CommissioningError(f"{path}: is empty; its first line must be {','.join(known)}")
    (_, header), *rows = rows
    missing = [name for name in required if name not in header]
    unknown = [name for name in header if name not in known]
    if missing or unknown or len(set(header)) < len(header):
        found = [f"misses {', '.join(missing)}"] if missing else []
        found += [f"has {', '.join(unknown)[:80]}"] if unknown else []
        raise CommissioningError(
            f"{path}: the header {' and '.join(found) or 'has a column twice'}; it must have "
            f"{', '.join(required)}, and may have {', '.join(optional) or 'nothing else'}"
        )
    if not rows:
        raise CommissioningError(f"{path}: has a header and no rows")
    for number, cells in rows:
        if len(cells) != len(header):
            raise CommissioningError(
                f"{path}: line {number} has {len(cells)} cells, the header {len(header)}"
            )
    return [
        _Row(f"{path}: line {number}", dict(zip(header, cells, strict=True)))
        for number, cells in rows
    ]
