"""Recordings as CSV: one row a sample, columns named with their units (docs/recordings.md)."""

from __future__ import annotations

import csv
import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final, TextIO

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array, some_of
from cablesense_base.files import written_whole
from cablesense_gap.recordings.recording import MAX_NUMBERS, Recording, RecordingError
from cablesense_sim.arm import Arm

if TYPE_CHECKING:
    import pandas as pd

TIME: Final = "time_s"
TRIAL: Final = "trial"
LOAD_SEGMENT: Final = "load_segment"
LOAD: Final = ("load_x_n", "load_y_n", "load_z_n")

MAX_FILE_BYTES = 200_000_000
"""Days at 5 Hz; what is larger is no recording of one protocol."""

_MAX_LINE_CHARACTERS = 100_000
_CELLS_AT_ONCE = 2_000_000
"""A cell takes some fifty bytes while a part of the file is parsed."""
_TIME_DECIMALS, _LOAD_DECIMALS, _TENSION_DECIMALS = 6, 4, 4
_COMMAND_DECIMALS = 6
"""A microradian moves the tension of a stiff cable by less than a sensor's step."""
_PER_ARM = re.compile(r"q\d+_cmd_rad|tension_\d+_n")


def command_columns(joint_count: int) -> list[str]:
    """`q1_cmd_rad` … for 2N joint angles, pitch then yaw of each joint, base first."""
    return [f"q{i + 1}_cmd_rad" for i in range(joint_count)]


def tension_columns(cable_count: int) -> list[str]:
    """`tension_1_n` … for M cables."""
    return [f"tension_{i + 1}_n" for i in range(cable_count)]


def all_columns(joint_count: int, cable_count: int) -> list[str]:
    """Every column, in the order of the file."""
    labels = [TIME, TRIAL, *command_columns(joint_count), LOAD_SEGMENT, *LOAD]
    return labels + tension_columns(cable_count)


def read_csv(path: str | Path, arm: Arm) -> Recording:
    """Read a recording of an arm; columns that the format does not know are left out.

    Only the form is checked here, the content by `checks`: an empty cell becomes NaN.

    Raises:
        RecordingError: not a file, too large, not CSV, a column missing, twice or of another arm,
            a cell that is no number.
    """
    path = Path(path)
    wanted = all_columns(arm.joint_count, arm.cable_count)
    columns = _checked_columns(path, wanted, arm)
    parts = _parts(path, wanted, max(1, _CELLS_AT_ONCE // columns))
    values = {name: np.concatenate([part[name] for part in parts]) for name in wanted}

    def stacked(names: Sequence[str]) -> Array:
        return np.stack([values[name] for name in names], axis=1)

    def whole(name: str) -> NDArray[np.int64]:
        bad = np.flatnonzero(~(values[name] == np.round(values[name])))
        bad = bad if bad.size else np.flatnonzero(np.abs(values[name]) > 1e9)
        if bad.size:
            row, cell = bad[0] + 1, values[name][bad[0]]
            raise RecordingError(f"{path}: row {row}, column {name}: {cell:g} is no whole number")
        return values[name].astype(np.int64)

    return Recording(
        name=path.stem,
        time_s=values[TIME],
        trial=whole(TRIAL),
        command_rad=stacked(command_columns(arm.joint_count)),
        load_segment=whole(LOAD_SEGMENT),
        load_n=stacked(LOAD),
        tensions_n=stacked(tension_columns(arm.cable_count)),
    )


def write_csv(path: str | Path, recording: Recording) -> None:
    """Write a recording; the file appears whole or not at all.

    Raises:
        RecordingError: the place cannot be written to.
    """
    import pandas as pd

    joints = command_columns(recording.command_rad.shape[1])
    cables = tension_columns(recording.tensions_n.shape[1])
    table = {
        **_texts([TIME], recording.time_s[:, None], _TIME_DECIMALS),
        TRIAL: recording.trial,
        **_texts(joints, recording.command_rad, _COMMAND_DECIMALS),
        LOAD_SEGMENT: recording.load_segment,
        **_texts(LOAD, recording.load_n, _LOAD_DECIMALS),
        **_texts(cables, recording.tensions_n, _TENSION_DECIMALS),
    }
    with written_whole(path, RecordingError) as beside:
        pd.DataFrame(table).to_csv(beside, index=False, lineterminator="\n")


def _checked_columns(path: Path, wanted: list[str], arm: Arm) -> int:
    """How many columns the file has; it is gone through once, a line at a time."""
    try:
        if not path.is_file():
            raise RecordingError(f"{path}: no such file")
        size_mb, most_mb = path.stat().st_size / 1e6, MAX_FILE_BYTES / 1e6
        if size_mb > most_mb:
            raise RecordingError(
                f"{path}: {size_mb:.0f} MB; a recording has at most {most_mb:.0f} MB: leave out "
                "what no trial needs"
            )
        with path.open(encoding="utf-8-sig", newline="") as file:
            line = file.readline(_MAX_LINE_CHARACTERS)
            # a quote left open would go on to any number of columns
            if len(line) == _MAX_LINE_CHARACTERS or line.count('"') % 2:
                raise RecordingError(
                    f"{path}: its first line has no end; it must name the columns"
                )
            header = [name.strip() for name in next(csv.reader([line]), [])]
            if len(header) == 1 and (other := next((c for c in ";\t" if c in line), "")):
                named = "semicolons" if other == ";" else "tabs"
                raise RecordingError(
                    f"{path}: {named} stand between its columns; a recording has commas there, "
                    "and a point in its numbers"
                )
            _check_names(path, header, wanted, arm)
            _check_lines(path, file, len(header), MAX_NUMBERS // len(wanted))
    except (OSError, ValueError, csv.Error) as error:
        raise RecordingError(f"{path}: cannot be read as CSV text ({error})") from error
    return len(header)


def _check_names(path: Path, header: list[str], wanted: list[str], arm: Arm) -> None:
    twice = sorted({name for name in header if name in wanted and header.count(name) > 1})
    if twice:
        raise RecordingError(f"{path}: columns {some_of(twice)} stand twice; each must be once")
    beyond = [name for name in header if _PER_ARM.fullmatch(name) and name not in wanted]
    missing = [name for name in wanted if name not in header]
    found = [f"misses {some_of(missing)}"] if missing else []
    found += [f"has {some_of(beyond)}, which that arm has not"] if beyond else []
    if found:
        raise RecordingError(
            f"{path}: {' and '.join(found)}; a recording of arm {arm.name} has time_s, trial, "
            f"q1_cmd_rad … q{arm.joint_count}_cmd_rad, load_segment, load_x_n, load_y_n, "
            f"load_z_n, tension_1_n … tension_{arm.cable_count}_n"
        )


def _check_lines(path: Path, file: TextIO, columns: int, most_rows: int) -> None:
    """Every line by itself is a row with no more cells than there are columns.

    A parser would hold any number of them, at 300 bytes each.
    """
    number = 1
    while line := file.readline(_MAX_LINE_CHARACTERS):
        number += 1
        cells = line.count(",") + 1
        if '"' in line:
            cells = len(next(csv.reader([line], strict=True, skipinitialspace=True)))
        # a comma at the end of each line is one of some programs
        if cells > columns + line.rstrip().endswith(",") or len(line) == _MAX_LINE_CHARACTERS:
            raise RecordingError(
                f"{path}: line {number} has more than {columns} cells, or no end; every row must "
                "have as many cells as the header"
            )
        if number > most_rows:
            raise RecordingError(
                f"{path}: more than {most_rows} rows; an hour at 1 kHz has fewer: split it"
            )


def _parts(path: Path, wanted: Sequence[str], rows_at_once: int) -> list[dict[str, Array]]:
    """The columns wanted of some rows at a time; at least one part."""
    import pandas as pd

    try:
        with (
            warnings.catch_warnings(),
            pd.read_csv(
                path,
                encoding="utf-8-sig",
                index_col=False,
                skipinitialspace=True,
                low_memory=False,
                usecols=lambda name: name.strip() in wanted,
                chunksize=rows_at_once,
            ) as tables,
        ):
            warnings.simplefilter("error", pd.errors.ParserWarning)
            parts = []
            for table in tables:
                table.columns = table.columns.str.strip()
                parts.append({name: _numbers(path, table[name]) for name in wanted})
            return parts
    except (OSError, ValueError, pd.errors.ParserWarning) as error:
        line = " ".join(str(error).split())
        raise RecordingError(
            f"{path}: not a table with one cell per column ({line}); every row must have as many "
            "cells as the header"
        ) from error


def _numbers(path: Path, column: pd.Series) -> Array:
    import pandas as pd

    try:
        numbers = pd.to_numeric(column, errors="coerce")
    except OverflowError as error:  # a whole number of hundreds of digits
        raise RecordingError(f"{path}: column {column.name}: a number without measure") from error
    bad = np.flatnonzero(numbers.isna() & column.notna())
    if column.dtype == bool or bad.size:
        at = int(bad[0]) if bad.size else 0
        cell = str(column.iloc[at])[:40]
        row = column.index[at] + 1
        raise RecordingError(f"{path}: row {row}, column {column.name}: {cell!r} is no number")
    return np.asarray(numbers, dtype=float)


def _texts(names: Sequence[str], values: Array, decimals: int) -> dict[str, list[str]]:
    """Columns (R, C) under their names."""
    columns = (np.round(values, decimals) + 0.0).T.tolist()  # no -0.0000
    return {
        name: [f"{value:.{decimals}f}" for value in column]
        for name, column in zip(names, columns, strict=True)
    }
