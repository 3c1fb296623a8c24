"""Datasets as Parquet files: one row a sample, units and provenance in the schema's metadata.

Metadata keys (all text): `cablesense.format` (version of this layout), `cablesense.arm_identity`,
`cablesense.arm` (the arm file's content, YAML), `cablesense.cables` and `cablesense.joints` (JSON
lists, the order of the columns), `cablesense.protocol` (JSON, kind and all options),
`cablesense.seed`, `cablesense.version` (of this package) and `cablesense.command`. Nothing in a
file depends on when, where or by how many workers it was made.

Files are read whole and every value is checked; they are written as the parts come, and appear
under their name only when they are whole.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
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
from cablesense_training.data.dataset import Dataset, Summary, combine, summarise
from cablesense_training.data.generation import generate
from cablesense_training.data.protocols import (
    CHUNK_SAMPLES,
    Protocol,
    SingleContact,
    protocol_from_options,
)
from cablesense_training.errors import DatasetError

FORMAT = "1"
PREFIX = "cablesense."


class Column(NamedTuple):
    """One column: `array[:, place]` of the dataset, or all of it when `place` is None."""

    name: str
    unit: str
    type: pa.DataType
    array: str
    place: int | None


def columns(arm: Arm, protocol: Protocol) -> list[Column]:
    """The columns of a dataset of that arm and protocol, in the file's order."""
    number, whole = pa.float64(), pa.int64()
    found = [Column("sample_id", "1", whole, "sample_id", None)]
    for i, name in enumerate(arm.joint_names):
        found.append(Column(f"command_{name}_rad", "rad", number, "command_rad", i))
    for label in ("tension_difference", "unloaded"):
        for i, name in enumerate(arm.cable_names):
            found.append(Column(f"{label}_{name}_n", "N", number, f"{label}_n", i))
    if isinstance(protocol, SingleContact):
        found.append(Column("segment", "1", whole, "segment", None))
        found.append(Column("angle_deg", "deg", number, "angle_deg", None))
        found.append(Column("magnitude_n", "N", number, "magnitude_n", None))
    else:
        for i in range(arm.segment_count):
            label = f"segment_{i + 1}"
            found.append(Column(f"contact_{label}", "1", pa.bool_(), "contacts", i))
            found.append(Column(f"angle_{label}_deg", "deg", number, "angles_deg", i))
            found.append(Column(f"magnitude_{label}_n", "N", number, "magnitudes_n", i))
    for name in ("slack_cables", "redrawn"):
        found.append(Column(name, "1", whole, name, None))
    return found


def schema(arm: Arm, protocol: Protocol, seed: int, command: str) -> pa.Schema:
    """Columns with their units, and the metadata of the module's docstring."""
    listed = [
        pa.field(c.name, c.type, nullable=False, metadata={"unit": c.unit})
        for c in columns(arm, protocol)
    ]
    metadata = {
        "format": FORMAT,
        "arm_identity": arm.identity,
        "arm": yaml.safe_dump(arm.model_dump(), sort_keys=False),
        "cables": json.dumps(arm.cable_names),
        "joints": json.dumps(arm.joint_names),
        "protocol": json.dumps(protocol.options(), sort_keys=True),
        "seed": str(seed),
        "version": package_version(),
        "command": command,
    }
    return pa.schema(listed, metadata={PREFIX + key: text for key, text in metadata.items()})


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


_ROWS_PER_GROUP = 32 * CHUNK_SAMPLES


def write_dataset(path: str | Path, dataset: Dataset, command: str = "") -> None:
    """Write a dataset; see `write_parts`."""
    head = (dataset.arm, dataset.protocol, dataset.seed)
    write_parts(path, dataset.parts(CHUNK_SAMPLES), *head, command)


def write_parts(
    path: str | Path,
    parts: Iterable[Dataset],
    arm: Arm,
    protocol: Protocol,
    seed: int,
    command: str = "",
) -> None:
    """Write the parts of one run as they come, in memory of a few dozen chunks.

    The file appears under its name when it is whole, replacing one that was there; on any failure
    nothing remains. `command` is recorded as the command that makes the dataset.

    Raises:
        DatasetError: the file cannot be written, or a part is of another run. Errors of `parts`
            pass through.
    """
    layout = columns(arm, protocol)
    described = schema(arm, protocol, seed, command)
    with (
        written_whole(path, DatasetError) as beside,
        pq.ParquetWriter(
            beside, described, compression="zstd", write_page_checksum=True
        ) as writer,
    ):
        for group in _groups(parts):
            if (group.arm, group.protocol, group.seed) != (arm, protocol, seed):
                raise DatasetError(
                    f"{path}: a part is of another run ({group.arm.identity}, seed {group.seed})"
                )
            table = pa.table([_values(group, c) for c in layout], schema=described)
            writer.write_table(table, row_group_size=_ROWS_PER_GROUP)


def _groups(parts: Iterable[Dataset]) -> Iterator[Dataset]:
    """Parts joined to row groups of one size, whatever the size of the parts."""
    held: list[Dataset] = []
    rows = 0
    for part in parts:
        held.append(part)
        rows += len(part)
        if rows >= _ROWS_PER_GROUP:
            joined = Dataset.concatenate(held)
            yield joined.select(slice(0, _ROWS_PER_GROUP))
            held = [joined.select(slice(_ROWS_PER_GROUP, None))]
            rows = len(held[0])
    if rows:
        yield Dataset.concatenate(held)


def _values(dataset: Dataset, column: Column) -> pa.Array:
    values = getattr(dataset, column.array)
    if column.place is not None:
        values = np.ascontiguousarray(values[:, column.place])
    return pa.array(values, type=column.type)


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
    """Write the dataset that arm, protocol and seed determine, and say what it holds.

    Raises:
        DatasetError: as `generate` and `write_parts`; nothing is written then.
    """
    parts = generate(arm, protocol, seed, workers=workers, dask_scheduler=dask_scheduler)
    summaries: list[Summary] = []
    with progress_bar(protocol.samples, shown=show_progress) as advance:

        def watched() -> Iterator[Dataset]:
            for part in parts:
                yield part
                summaries.append(summarise(part))
                advance(len(part))

        write_parts(path, watched(), arm, protocol, seed, command)
    return combine(summaries)
