"""Tables that people write by hand: a CSV file of a few columns and at most some thousand rows."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

from cablesense_msgs_py.bounded_file import read_bounded_text
from cablesense_ros.commissioning.commissioning_error import CommissioningError

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
