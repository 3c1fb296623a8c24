"""Recordings as CSV: one row per sample, columns named with their units (docs/recordings.md).

`read_table` reads the columns of any recording, `read_csv` those of an arm or of a machine that
MuJoCo describes; `write_csv` writes those of an arm.
"""

from __future__ import annotations

import csv
import gzip
import warnings
import zlib
from collections.abc import Collection, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cablesense_base import Array, some_of
from cablesense_base.files import plain_name, written_whole
from cablesense_recording.channels import (
    LOAD,
    LOAD_AT,
    LOAD_SEGMENT,
    TIME,
    TRIAL,
    arm_channels,
    command_columns,
    tension_columns,
)
from cablesense_recording.layout import LABELS, Described, Layout, layout_of
from cablesense_recording.recording import (
    MAX_NUMBERS,
    Recording,
    RecordingError,
    derive_trials,
    given_places,
)
from cablesense_recording.units import OTHER_TIME_UNITS

LONGEST_S: Final = 1e10
"""Any time is nearer to any epoch, and rows a microsecond apart can still be distinguished."""
CSV_ENDINGS: Final = (".csv", ".csv.gz")

MAX_FILE_BYTES = 500_000_000
"""Days at 5 Hz; a larger file is not a recording of one protocol."""

_MOST_LINES_BEFORE = 100
_BEGIN_BYTES = 100_000
_SHOWN_BYTES = 200
_AROUND_BYTES = 12

_DECIMALS = 6
"""A microradian changes the tension of a stiff cable by less than a sensor's step."""


def all_columns(joint_count: int, cable_count: int) -> list[str]:
    """Every column that an arm's recording must have, in the order of the file."""
    return [each.label for each in arm_channels(joint_count, cable_count) if each.needed]


def csv_stem(path: Path) -> str:
    """The file's name without `.csv` or `.csv.gz`."""
    return plain_name(path.name.removesuffix(".gz").removesuffix(".csv"))


def read_table(path: str | Path, prefixes: Collection[str]) -> dict[str, Array]:
    """The columns (R,) of a .csv or .csv.gz file whose names begin with one of the prefixes.

    Other columns are ignored. An empty cell becomes NaN.

    Raises:
        RecordingError: not a file, too large, not CSV, not UTF-8, lines before the header, a
            column that appears twice, a row with more cells than the header, or a cell that is
            not a number.
    """
    import pandas as pd

    path = Path(path)
    if not path.is_file():
        raise RecordingError(f"{path}: no such file")
    if path.stat().st_size > MAX_FILE_BYTES:
        raise RecordingError(
            f"{path}: {path.stat().st_size / 1e6:.0f} MB; a recording has at most "
            f"{MAX_FILE_BYTES / 1e6:.0f} MB: split it"
        )
    if path.stat().st_size == 0:
        raise RecordingError(
            f"{path}: is empty; its recorder was stopped before it wrote anything"
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)
            header = pd.read_csv(
                path, header=None, nrows=1, dtype=str, encoding="utf-8-sig", skipinitialspace=True
            )
            names = [str(cell).strip() for cell in header.iloc[0]]
            _check_header(path, names, prefixes)
            most_rows = MAX_NUMBERS // len(names)  # a packed file can hold any number
            table = pd.read_csv(
                path,
                encoding="utf-8-sig",
                index_col=False,
                skipinitialspace=True,
                low_memory=False,
                nrows=most_rows + 1,
            )
    except UnicodeDecodeError as error:
        raise RecordingError(f"{path}: {_no_utf8(path)}") from error
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise RecordingError(
            f"{path}: cannot be unpacked ({error}); `zcat` shows what of it is whole, and a file "
            "that is not packed ends in .csv"
        ) from error
    except (OSError, ValueError, OverflowError, pd.errors.ParserWarning) as error:
        line = " ".join(str(error).split())[:200]
        raise RecordingError(
            f"{path}: cannot be read as CSV text ({line}); every row must have as many cells as "
            "the header"
        ) from error
    if len(table) > most_rows:
        raise RecordingError(f"{path}: more than {MAX_NUMBERS} numbers; split it")
    columns = {}
    for name, (_, column) in zip(names, table.items(), strict=False):
        if name.startswith(tuple(prefixes)):
            if column.dtype.kind not in "if":
                column = column.astype(str).where(column.notna())
            values = pd.to_numeric(column, errors="coerce").to_numpy(float)
            wrong = np.isnan(values) & column.notna().to_numpy()
            why = "is no number"
            if name == TIME and not wrong.any():
                wrong = np.abs(values) > LONGEST_S
                units = ", ".join(OTHER_TIME_UNITS)
                why = f"is beyond {LONGEST_S:g} s; times must be in seconds ({units} given?)"
            if wrong.any():
                cell = str(column.iloc[wrong.argmax()])[:40]
                raise RecordingError(
                    f"{path}: row {wrong.argmax() + 1}, column {name}: {cell!r} {why}"
                )
            columns[name] = values
    return columns


def write_table(path: str | Path, columns: Mapping[str, Any], float_format: str) -> None:
    """Write columns (R,) as CSV; the file appears whole or not at all.

    Raises:
        RecordingError: the place cannot be written to.
    """
    import pandas as pd

    with written_whole(path, RecordingError) as beside:
        pd.DataFrame(columns).to_csv(
            beside, index=False, lineterminator="\n", float_format=float_format
        )


def stacked(values: Mapping[str, Array], names: Sequence[str]) -> Array:
    """(R, K) the columns (R,) of K names, side by side."""
    return np.stack([values[name] for name in names], axis=1)


def whole_numbers(path: Path, name: str, column: Array) -> NDArray[np.int64]:
    """(R,) a column of a file that holds whole numbers.

    Raises:
        RecordingError: one is not whole, or beyond 1e9.
    """
    bad = np.flatnonzero(~(column == np.round(column)) | (np.abs(column) > 1e9))
    if bad.size:
        raise RecordingError(
            f"{path}: row {bad[0] + 1}, column {name}: {column[bad[0]]:g} is no whole number"
        )
    return column.astype(np.int64)


def read_csv(path: str | Path, machine: Described) -> Recording:
    """Read a recording of a machine. Only the form is checked here, the content by `checks`.

    Of an arm it has trials and loads. Of another machine, without these columns trials are derived
    and nothing acts on it.

    Raises:
        RecordingError: as `read_table`; a column is missing or belongs to another machine.
    """
    path = Path(path)
    layout = layout_of(machine)
    values = _columns_of(path, layout)

    time_s = values[TIME]
    command = stacked(values, layout.command_columns)
    segment = np.zeros(len(time_s), dtype=np.int64)
    load_n = np.zeros((len(time_s), 3))
    if LOAD_SEGMENT in values:
        segment = whole_numbers(path, LOAD_SEGMENT, values[LOAD_SEGMENT])
        load_n = stacked(values, LOAD)
    place_m = given_places(values.get(LOAD_AT))
    if TRIAL in values:
        trial = whole_numbers(path, TRIAL, values[TRIAL])
    else:
        trial = derive_trials(time_s, command, segment, load_n, place_m)
    return Recording(
        name=csv_stem(path),
        time_s=time_s,
        trial=trial,
        command_rad=command,
        load_segment=segment,
        load_n=load_n,
        tensions_n=stacked(values, layout.reading_columns),
        load_at_m=place_m,
    )


def _columns_of(path: Path, layout: Layout) -> dict[str, Array]:
    """The columns (R,) of a recording that a layout has.

    Raises:
        RecordingError: as `read_table`; a column is missing or belongs to another machine.
    """
    needed = [TIME, *layout.command_columns, *layout.reading_columns]
    known = {*needed, *LABELS, LOAD_AT}
    prefixes = (*known, "q", "tension_") if layout.needs_labels else known
    read = read_table(path, prefixes)
    values = {
        name: column for name, column in read.items() if name in known or layout.is_foreign(name)
    }
    of_load = (LOAD_SEGMENT, *LOAD)
    if layout.needs_labels:
        needed += LABELS
    elif any(name in values for name in of_load):
        needed += of_load
    beyond = [name for name in values if name not in known]
    missing = [name for name in needed if name not in values]
    problems = [f"misses {some_of(missing)}"] if missing else []
    problems += [f"has {some_of(beyond)}, which that machine has not"] if beyond else []
    if problems:
        labels = f"{TRIAL}, " if layout.needs_labels else ""
        loads = f", {', '.join(of_load)}" if layout.needs_labels else ""
        raise RecordingError(
            f"{path}: {' and '.join(problems)}; a recording of {layout.name} has {TIME}, {labels}"
            f"{_from_to(layout.command_columns)}{loads}, {_from_to(layout.reading_columns)}"
        )
    return values


def _from_to(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{names[0]} … {names[-1]}"


def write_csv(path: str | Path, recording: Recording) -> None:
    """Write a recording of an arm; the file appears whole or not at all.

    Raises:
        RecordingError: the place cannot be written to.
    """
    joints = command_columns(recording.command_rad.shape[1])
    cables = tension_columns(recording.tensions_n.shape[1])
    columns = {TIME: recording.time_s, TRIAL: recording.trial}
    columns |= zip(joints, recording.command_rad.T, strict=True)
    columns[LOAD_SEGMENT] = recording.load_segment
    columns |= zip(LOAD, recording.load_n.T, strict=True)
    if recording.load_at_m is not None:
        columns[LOAD_AT] = recording.load_at_m
    columns |= zip(cables, recording.tensions_n.T, strict=True)
    # rounded, and without -0
    rounded = {name: np.round(values, _DECIMALS) + 0 for name, values in columns.items()}
    write_table(path, rounded, "%.12g")


def _check_header(path: Path, names: list[str], prefixes: Collection[str]) -> None:
    other = next((mark for mark in ";\t" if len(names) == 1 and mark in names[0]), "")
    if other:
        named = "semicolons" if other == ";" else "tabs"
        raise RecordingError(
            f"{path}: {named} separate its columns; a recording has commas there, and a point in "
            "its numbers"
        )
    if TIME not in names:
        _refuse_lines_before(path)
    known = [name for name in names if name.startswith(tuple(prefixes))]
    twice = sorted({name for name in known if known.count(name) > 1})
    if twice:
        raise RecordingError(f"{path}: column {some_of(twice)} appears twice; once is right")


def _refuse_lines_before(path: Path) -> None:
    """Comments and the like before the line that names the columns."""
    begin = _begin_of(path)
    if b"\0" in begin:
        raise RecordingError(f"{path}: {_no_utf8(path)}")
    lines = begin.decode("utf-8-sig", "replace").splitlines()
    for number, line in enumerate(lines[:_MOST_LINES_BEFORE], start=1):
        cells = [cell.strip() for cell in next(csv.reader([line], skipinitialspace=True), [])]
        if TIME in cells:
            raise RecordingError(
                f"{path}: names its columns in line {number}; leave out the lines before it, of "
                f"which the first is {lines[0].strip()[:40]!r}"
            )
        if line.lstrip().startswith("#") and TIME in [cell.lstrip("# ") for cell in cells]:
            raise RecordingError(
                f"{path}: line {number}, which names the columns, begins with #; leave the # out"
            )


def _begin_of(path: Path) -> bytes:
    with gzip.open(path) if path.suffix == ".gz" else path.open("rb") as file:
        return file.read(_BEGIN_BYTES)


def _no_utf8(path: Path) -> str:
    """Where a file is no UTF-8 text, and what to do."""
    begin = _begin_of(path)
    if b"\0" in begin[:_SHOWN_BYTES]:
        return "is UTF-16 text or no text at all; save it as CSV in UTF-8"
    with gzip.open(path) if path.suffix == ".gz" else path.open("rb") as file:
        for number, line in enumerate(iter(partial(file.readline, _BEGIN_BYTES), b""), start=1):
            try:
                line.decode("utf-8")
            except UnicodeDecodeError as error:
                around = line[max(error.start - _AROUND_BYTES, 0) : error.start + 2]
                shown = around.decode("cp1252", "replace").strip()
                return (
                    f"line {number} is no UTF-8 text (byte 0x{line[error.start]:02x} in "
                    f"{shown!r}); save the file as UTF-8"
                )
    return "is no UTF-8 text; save it as UTF-8"
