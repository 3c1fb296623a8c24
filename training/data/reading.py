"""Datasets from Parquet files: read whole, and believed only after every check."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from cablesense_sim.arm import Arm, ArmFileError, parse_arm
from cablesense_training.data.dataset import Dataset
from cablesense_training.data.errors import DatasetError
from cablesense_training.data.layout import FORMAT, PREFIX, Column, columns
from cablesense_training.data.protocols import Protocol, SingleContact, protocol_from_options

MAX_COLUMNS = 2_000
"""Far more than the largest arm has."""

LARGEST_UNPACKED_B, MAX_UNPACKING = 2**26, 100
"""A dataset may hold so many bytes, and so many more for each byte of its file."""


def read_dataset(path: str | Path, arm: Arm | None = None) -> Dataset:
    """The dataset in a Parquet file that `write_dataset` or `cablesense dataset` wrote.

    Args:
        path: the file.
        arm: the arm that the samples must come from; None takes any.

    Raises:
        DatasetError: not such a file, cut short, of another arm than `arm`, a column missing or
            with another type or unit, a value that is not finite or out of its range.
    """
    path = Path(path)
    table = _read_table(path)
    found = {
        key.decode().removeprefix(PREFIX): value.decode(errors="replace")
        for key, value in (table.schema.metadata or {}).items()
        if key.startswith(PREFIX.encode())
    }
    stored, protocol, seed = _provenance(path, found)
    if arm is not None and stored.identity != arm.identity:
        raise DatasetError(
            f"{path}: comes from arm {stored.identity}, and {arm.identity} was asked for; "
            "generate the dataset again with that arm's file"
        )
    layout = columns(stored, protocol)
    _check_columns(path, table.schema, layout)
    if table.num_rows == 0:
        raise DatasetError(f"{path}: holds no samples; it must hold at least one")
    arrays: dict[str, np.ndarray] = {}
    for column in layout:
        values = _column_values(path, table, column)
        if column.place is None:
            arrays[column.array] = values
        else:
            shape = (len(values), sum(c.array == column.array for c in layout))
            arrays.setdefault(column.array, np.empty(shape, values.dtype))
            arrays[column.array][:, column.place] = values
    if isinstance(protocol, SingleContact):
        _expand_single(path, arrays, stored.segment_count)
    _check_labels(path, arrays, protocol)
    return Dataset(arm=stored, protocol=protocol, seed=seed, **arrays)


def _read_table(path: Path) -> pa.Table:
    try:
        if path.exists() and not path.is_file():  # a pipe would keep an open waiting
            raise DatasetError(f"{path}: not a Parquet file, nor a file at all")
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            _require_credible(path, file.metadata.num_rows, file.metadata.num_columns)
            return file.read()
    except FileNotFoundError as error:
        raise DatasetError(
            f"{path}: no such file; `cablesense dataset --out {path}` writes one"
        ) from error
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        reason = " ".join(str(error).split())
        raise DatasetError(f"{path}: not a Parquet file, or cut short ({reason})") from error


def _require_credible(path: Path, rows: int, width: int) -> None:
    """A few bytes of Parquet can stand for any number of equal rows; no measured ones do."""
    unpacked, packed = 8 * rows * width, path.stat().st_size
    if width > MAX_COLUMNS or unpacked > LARGEST_UNPACKED_B + MAX_UNPACKING * packed:
        raise DatasetError(
            f"{path}: says {rows} rows of {width} columns in {packed} bytes; no dataset is packed "
            "so tightly: generate it again"
        )


def _provenance(path: Path, found: dict[str, str]) -> tuple[Arm, Protocol, int]:
    """Arm, protocol and seed from the metadata."""
    version = found.get("format")
    if version is None:
        raise DatasetError(
            f"{path}: a Parquet file, but not a CableSense dataset (its metadata lacks "
            f"{PREFIX}format); "
            "`cablesense dataset` writes one"
        )
    if version != FORMAT:
        raise DatasetError(f"{path}: format {version!r}; this version reads format {FORMAT!r}")
    for key in ("arm_identity", "arm", "cables", "joints", "protocol", "seed"):
        if key not in found:
            raise DatasetError(f"{path}: lacks metadata {PREFIX}{key}; generate it again")
    try:
        arm = parse_arm(found["arm"], source=f"{path}, {PREFIX}arm")
    except ArmFileError as error:
        raise DatasetError(str(error)) from error
    if arm.identity != found["arm_identity"]:
        raise DatasetError(
            f"{path}: says arm {found['arm_identity']}, but describes {arm.identity}; "
            "the metadata was altered, generate the dataset again"
        )
    for key, right in (("cables", arm.cable_names), ("joints", arm.joint_names)):
        if found[key] != json.dumps(right):
            raise DatasetError(
                f"{path}: {PREFIX}{key} = {found[key]}; arm {arm.identity} has {json.dumps(right)}"
            )
    try:
        options = json.loads(found["protocol"])
        protocol = protocol_from_options(options)
        seed = int(found["seed"])
    except (ValueError, TypeError, RecursionError, DatasetError) as error:
        raise DatasetError(f"{path}: {PREFIX}protocol or {PREFIX}seed: {error}") from error
    return arm, protocol, seed


def _check_columns(path: Path, found: pa.Schema, layout: list[Column]) -> None:
    names = [c.name for c in layout]
    missing = [name for name in names if name not in found.names]
    if missing:
        raise DatasetError(f"{path}: lacks column {missing[0]!r}; needed: {', '.join(names)}")
    unknown = [name for name in found.names if name not in names]
    if unknown or len(found.names) != len(names):
        extra = unknown[0] if unknown else "one twice"
        raise DatasetError(f"{path}: unknown column {extra!r}; valid: {', '.join(names)}")
    for column in layout:
        field = found.field(column.name)
        if field.type != column.type:
            raise DatasetError(
                f"{path}: column {column.name!r} holds {field.type}, and must hold {column.type}"
            )
        unit = (field.metadata or {}).get(b"unit", b"").decode(errors="replace")
        if unit != column.unit:
            raise DatasetError(
                f"{path}: column {column.name!r} is in {unit or 'no unit'!r}, "
                f"and must be in {column.unit!r}"
            )


def _column_values(path: Path, table: pa.Table, column: Column) -> np.ndarray:
    chunked = table.column(column.name)
    if chunked.null_count:
        raise DatasetError(f"{path}: column {column.name!r} has {chunked.null_count} empty values")
    values = np.array(chunked.to_numpy())
    if column.type == pa.float64():
        _refuse(path, column.name, values, ~np.isfinite(values), "must be a finite number")
    return values


def _expand_single(path: Path, arrays: dict[str, np.ndarray], count: int) -> None:
    """Per-segment arrays from the segment's number, angle and magnitude."""
    segment = arrays.pop("segment")
    bad = (segment < 0) | (segment > count)
    _refuse(path, "segment", segment, bad, f"must be 0 (no contact) to {count}")
    contacts = segment[:, None] == np.arange(1, count + 1)
    for array, name in (("angles_deg", "angle_deg"), ("magnitudes_n", "magnitude_n")):
        values = arrays.pop(name)
        _refuse(path, name, values, (segment == 0) & (values != 0.0), "must be 0 without contact")
        arrays[array] = np.where(contacts, values[:, None], 0.0)
    arrays["contacts"] = contacts


def _check_labels(path: Path, arrays: dict[str, np.ndarray], protocol: Protocol) -> None:
    contacts, magnitude, angle = (
        arrays[name] for name in ("contacts", "magnitudes_n", "angles_deg")
    )
    low, high = protocol.force_low_n, protocol.force_high_n
    outside = contacts & ((magnitude < low) | (magnitude > high))
    _refuse(path, "magnitude", magnitude, outside, f"must be from {low:g} to {high:g} N")
    idle = ~contacts & ((magnitude != 0.0) | (angle != 0.0))
    _refuse(path, "magnitude", magnitude, idle, "magnitude and angle must be 0 without contact")
    turned = (angle < 0.0) | (angle >= 360.0)
    _refuse(path, "angle", angle, turned, "must be from 0 to below 360 degrees")


def _refuse(path: Path, name: str, values: np.ndarray, bad: np.ndarray, right: str) -> None:
    if bad.any():
        place = tuple(int(i) for i in np.argwhere(bad)[0])
        raise DatasetError(f"{path}: {name!r} in row {place[0]} is {values[place]}: {right}")
