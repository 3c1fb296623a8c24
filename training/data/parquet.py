"""Datasets as Parquet files: one row a sample, units and provenance in the schema's metadata.

docs/data.md describes the columns and the metadata. Nothing in a file depends on when, where or
by how many workers it was made. Files are read whole and every value is checked.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import yaml

from cablesense_base.files import written_whole
from cablesense_base.installation import package_version
from cablesense_base.progress import progress_bar
from cablesense_sim.arm import Arm, ArmFileError, parse_arm
from cablesense_training.data.dataset import Dataset, Summary, summarise
from cablesense_training.data.generation import generate
from cablesense_training.data.protocols import (
    CHUNK_SAMPLES,
    Protocol,
    SingleContact,
    protocol_from_options,
)
from cablesense_training.errors import DatasetError

_FORMAT = "1"
_PREFIX = "cablesense."
_ROWS_PER_GROUP = 32 * CHUNK_SAMPLES

_MAX_COLUMNS = 2_000
"""Far more than the largest arm has."""

_LARGEST_UNPACKED_B, _MAX_UNPACKING = 2**26, 100
"""Largest unpacked size in bytes, and the largest number for each byte of the file."""


class _Column(NamedTuple):
    """One column: `array[:, place]` of the dataset, or all of it when `place` is None."""

    field: pa.Field
    array: str
    place: int | None

    @property
    def name(self) -> str:
        return str(self.field.name)


def _columns(arm: Arm, protocol: Protocol) -> list[_Column]:
    """The columns of a dataset of that arm and protocol, in the file's order."""
    found: list[_Column] = []

    def add(name: str, unit: str, kind: pa.DataType, array: str, place: int | None = None) -> None:
        field = pa.field(name, kind, nullable=False, metadata={"unit": unit})
        found.append(_Column(field, array, place))

    number, whole = pa.float64(), pa.int64()
    add("sample_id", "1", whole, "sample_id")
    for i, name in enumerate(arm.joint_names):
        add(f"command_{name}_rad", "rad", number, "command_rad", i)
    for label in ("tension_difference", "unloaded"):
        for i, name in enumerate(arm.cable_names):
            add(f"{label}_{name}_n", "N", number, f"{label}_n", i)
    if isinstance(protocol, SingleContact):
        add("segment", "1", whole, "segment")
        add("angle_deg", "deg", number, "angle_deg")
        add("magnitude_n", "N", number, "magnitude_n")
    else:
        for i in range(arm.segment_count):
            label = f"segment_{i + 1}"
            add(f"contact_{label}", "1", pa.bool_(), "contacts", i)
            add(f"angle_{label}_deg", "deg", number, "angles_deg", i)
            add(f"magnitude_{label}_n", "N", number, "magnitudes_n", i)
    for name in ("slack_cables", "redrawn"):
        add(name, "1", whole, name)
    return found


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
        key.decode().removeprefix(_PREFIX): value.decode(errors="replace")
        for key, value in (table.schema.metadata or {}).items()
        if key.startswith(_PREFIX.encode())
    }
    stored, protocol, seed = _provenance(path, found)
    if arm is not None and stored.identity != arm.identity:
        raise DatasetError(
            f"{path}: comes from arm {stored.identity}, and {arm.identity} was asked for; "
            "generate the dataset again with that arm's file"
        )
    layout = _columns(stored, protocol)
    _require_columns(path, table.schema, layout)
    if table.num_rows == 0:
        raise DatasetError(f"{path}: holds no samples; it must hold at least one")
    parts: dict[str, list[np.ndarray]] = {}
    for column in layout:
        parts.setdefault(column.array, []).append(_column_values(path, table, column))
    single = {column.array for column in layout if column.place is None}
    arrays = {
        name: values[0] if name in single else np.stack(values, axis=1)
        for name, values in parts.items()
    }
    if isinstance(protocol, SingleContact):
        _expand_single(path, arrays, stored.segment_count)
    contacts, magnitude, angle = arrays["contacts"], arrays["magnitudes_n"], arrays["angles_deg"]
    low, high = protocol.force_low_n, protocol.force_high_n
    outside = contacts & ((magnitude < low) | (magnitude > high))
    _refuse(path, "magnitude", magnitude, outside, f"must be from {low:g} to {high:g} N")
    idle = ~contacts & ((magnitude != 0.0) | (angle != 0.0))
    _refuse(path, "magnitude", magnitude, idle, "magnitude and angle must be 0 without contact")
    turned = (angle < 0.0) | (angle >= 360.0)
    _refuse(path, "angle", angle, turned, "must be from 0 to below 360 degrees")
    return Dataset(arm=stored, protocol=protocol, seed=seed, **arrays)


def _read_table(path: Path) -> pa.Table:
    try:
        if path.exists() and not path.is_file():  # a pipe would keep an open waiting
            raise DatasetError(f"{path}: not a Parquet file, nor a file at all")
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            rows, width = file.metadata.num_rows, file.metadata.num_columns
            # a few bytes of Parquet can stand for any number of equal rows; no measured ones do
            unpacked, packed = 8 * rows * width, path.stat().st_size
            if width > _MAX_COLUMNS or unpacked > _LARGEST_UNPACKED_B + _MAX_UNPACKING * packed:
                raise DatasetError(
                    f"{path}: claims {rows} rows of {width} columns in {packed} bytes; no dataset "
                    "is packed so tightly: generate it again"
                )
            return file.read()
    except FileNotFoundError as error:
        raise DatasetError(
            f"{path}: no such file; `cablesense dataset --out {path}` writes one"
        ) from error
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        reason = " ".join(str(error).split())
        raise DatasetError(f"{path}: not a Parquet file, or cut short ({reason})") from error


def _provenance(path: Path, found: dict[str, str]) -> tuple[Arm, Protocol, int]:
    """Arm, protocol and seed from the metadata."""
    version = found.get("format")
    if version is None:
        raise DatasetError(
            f"{path}: a Parquet file, but not a CableSense dataset (its metadata lacks "
            f"{_PREFIX}format); `cablesense dataset` writes one"
        )
    if version != _FORMAT:
        raise DatasetError(f"{path}: format {version!r}; this version reads format {_FORMAT!r}")
    for key in ("arm_identity", "arm", "cables", "joints", "protocol", "seed"):
        if key not in found:
            raise DatasetError(f"{path}: lacks metadata {_PREFIX}{key}; generate it again")
    try:
        arm = parse_arm(found["arm"], source=f"{path}, {_PREFIX}arm")
    except ArmFileError as error:
        raise DatasetError(str(error)) from error
    for key, right in _arm_metadata(arm).items():
        if found[key] != right:
            raise DatasetError(
                f"{path}: {_PREFIX}{key} = {found[key]}, but the arm it describes has {right}; "
                "the metadata was altered, generate the dataset again"
            )
    try:
        protocol = protocol_from_options(json.loads(found["protocol"]))
        seed = int(found["seed"])
    except (ValueError, TypeError, RecursionError, DatasetError) as error:
        raise DatasetError(f"{path}: {_PREFIX}protocol or {_PREFIX}seed: {error}") from error
    return arm, protocol, seed


def _arm_metadata(arm: Arm) -> dict[str, str]:
    """Metadata that repeat parts of the arm: its name and hash, the order of the columns."""
    return {
        "arm_identity": arm.identity,
        "cables": json.dumps(arm.cable_names),
        "joints": json.dumps(arm.joint_names),
    }


def _require_columns(path: Path, found: pa.Schema, layout: list[_Column]) -> None:
    names = [c.name for c in layout]
    missing = [name for name in names if name not in found.names]
    if missing:
        raise DatasetError(f"{path}: lacks column {missing[0]!r}; needed: {', '.join(names)}")
    unknown = [name for name in found.names if name not in names]
    if unknown or len(found.names) != len(names):
        extra = unknown[0] if unknown else "one twice"
        raise DatasetError(f"{path}: unknown column {extra!r}; valid: {', '.join(names)}")
    for right in (column.field for column in layout):
        (kind, unit), (right_kind, right_unit) = (
            (f.type, (f.metadata or {}).get(b"unit", b"no unit").decode(errors="replace"))
            for f in (found.field(right.name), right)
        )
        if (kind, unit) != (right_kind, right_unit):
            raise DatasetError(
                f"{path}: column {right.name!r} holds {kind} in {unit!r}, and must hold "
                f"{right_kind} in {right_unit!r}"
            )


def _column_values(path: Path, table: pa.Table, column: _Column) -> np.ndarray:
    chunked = table.column(column.name)
    if chunked.null_count:
        raise DatasetError(f"{path}: column {column.name!r} has {chunked.null_count} empty values")
    values = np.array(chunked.to_numpy())
    if column.field.type == pa.float64():
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


def _refuse(path: Path, name: str, values: np.ndarray, bad: np.ndarray, right: str) -> None:
    if bad.any():
        place = tuple(int(i) for i in np.argwhere(bad)[0])
        raise DatasetError(f"{path}: {name!r} in row {place[0]} is {values[place]}: {right}")


def write_dataset(path: str | Path, dataset: Dataset, command: str = "") -> None:
    """Write a dataset to a file that appears under its name when it is whole.

    `command` is recorded as the command that makes the dataset.

    Raises:
        DatasetError: the file cannot be written.
    """
    run = dataset.arm, dataset.protocol, dataset.seed
    deque(_written(path, dataset.parts(_ROWS_PER_GROUP), *run, command), maxlen=0)


def produce_dataset(
    path: str | Path,
    arm: Arm,
    protocol: Protocol,
    seed: int,
    *,
    command: str,
    workers: int = 1,
    dask_scheduler: str | None = None,
    show_progress: bool = False,
) -> Summary:
    """Write the dataset that arm, protocol and seed determine, in memory of a few dozen chunks.

    Raises:
        DatasetError: as `generate` and `write_dataset`; nothing is written then.
    """
    chunks = generate(arm, protocol, seed, workers=workers, dask_scheduler=dask_scheduler)
    with progress_bar(protocol.samples, shown=show_progress) as advance:

        def counted() -> Iterator[Dataset]:
            for chunk in chunks:
                yield chunk
                advance(len(chunk))

        drawn = counted()
        groups = iter(lambda: list(islice(drawn, _ROWS_PER_GROUP // CHUNK_SAMPLES)), [])
        parts = map(Dataset.concatenate, groups)
        return summarise(_written(path, parts, arm, protocol, seed, command))


def _written(
    path: str | Path,
    groups: Iterable[Dataset],
    arm: Arm,
    protocol: Protocol,
    seed: int,
    command: str,
) -> Iterator[Dataset]:
    """Write the parts of one run, a row group each, and hand them on; on any failure no file.

    Raises:
        DatasetError: the file cannot be written. Errors of `groups` pass through.
    """
    layout, repeated = _columns(arm, protocol), _arm_metadata(arm)
    metadata = {
        "format": _FORMAT,
        "arm_identity": repeated.pop("arm_identity"),
        "arm": yaml.safe_dump(arm.model_dump(), sort_keys=False),
        **repeated,
        "protocol": json.dumps(protocol.options(), sort_keys=True),
        "seed": str(seed),
        "version": package_version(),
        "command": command,
    }
    schema = pa.schema(
        [column.field for column in layout],
        metadata={_PREFIX + key: text for key, text in metadata.items()},
    )
    with (
        written_whole(path, DatasetError) as beside,
        pq.ParquetWriter(beside, schema, compression="zstd", write_page_checksum=True) as writer,
    ):
        for group in groups:
            values = [
                pa.array(
                    getattr(group, c.array)[:, c.place].copy()
                    if c.place is not None
                    else getattr(group, c.array),
                    type=c.field.type,
                )
                for c in layout
            ]
            writer.write_table(pa.table(values, schema=schema), row_group_size=_ROWS_PER_GROUP)
            yield group
