"""Datasets as Parquet files: one row a sample, units and provenance in the schema's metadata.

docs/data.md describes both. Nothing in a file depends on when, where or by how many workers it was
made. Files are read whole and every value is checked.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Iterable, Iterator
from itertools import islice, zip_longest
from pathlib import Path
from typing import Any, NamedTuple

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
_CHUNKS_PER_GROUP = 32
"""Of a row group: 65,536 samples, which are held in memory together."""

_LARGEST_UNPACKED_B = 2**26
"""Unpacked size, bytes, that any file may have."""
_MAX_UNPACKING = 100
"""Unpacked bytes for each byte of a larger file."""


class _Column(NamedTuple):
    """One column: `array[:, place]` of the dataset, or all of it when `place` is None."""

    name: str
    unit: str
    array: str
    place: int | None = None

    @property
    def field(self) -> pa.Field:
        """The column as Arrow has it."""
        kind = pa.int64() if self.unit == "1" else pa.float64()
        if self.array == "contacts":
            kind = pa.bool_()
        return pa.field(self.name, kind, nullable=False, metadata={"unit": self.unit})


def _columns(arm: Arm, protocol: Protocol) -> list[_Column]:
    """The columns of a dataset of that arm and protocol, in the file's order."""
    columns = [_Column("sample_id", "1", "sample_id")]
    for i, name in enumerate(arm.joint_names):
        columns.append(_Column(f"command_{name}_rad", "rad", "command_rad", i))
    for label in ("tension_difference", "unloaded"):
        for i, name in enumerate(arm.cable_names):
            columns.append(_Column(f"{label}_{name}_n", "N", f"{label}_n", i))
    if isinstance(protocol, SingleContact):
        units = {"segment": "1", "angle_deg": "deg", "magnitude_n": "N"}
        columns += [_Column(name, unit, name) for name, unit in units.items()]
    else:
        for i in range(arm.segment_count):
            columns += [
                _Column(f"contact_segment_{i + 1}", "1", "contacts", i),
                _Column(f"angle_segment_{i + 1}_deg", "deg", "angles_deg", i),
                _Column(f"magnitude_segment_{i + 1}_n", "N", "magnitudes_n", i),
            ]
            if protocol.anywhere:
                columns += [
                    _Column(f"place_segment_{i + 1}_m", "m", "places_m", i),
                    _Column(f"along_segment_{i + 1}_n", "N", "along_n", i),
                ]
    return [*columns, *(_Column(name, "1", name) for name in ("slack_cables", "redrawn"))]


def read_dataset(path: str | Path, arm: Arm | None = None) -> Dataset:
    """The dataset in a Parquet file that `write_dataset` or `cablesense dataset` wrote.

    Raises:
        DatasetError: not such a file, cut short, of another arm than `arm` if one is given, a
            column missing or with another type or unit, a value not finite or out of its range.
    """
    path = Path(path)
    table = _read_table(path)
    stored, protocol, seed = _provenance(path, table.schema)
    if arm is not None and stored.identity != arm.identity:
        raise DatasetError(
            f"{path}: comes from arm {stored.identity}, and {arm.identity} was asked for; "
            "generate the dataset again with that arm's file"
        )
    if table.num_rows == 0:
        raise DatasetError(f"{path}: holds no samples; it must hold at least one")
    arrays: dict[str, Any] = {}
    for column in _columns(stored, protocol):
        values = np.array(table.column(column.name).to_numpy())
        if bad := np.flatnonzero(~np.isfinite(values)).tolist():
            raise DatasetError(
                f"{path}: {column.name!r} in row {bad[0]} is {values[bad[0]]}: "
                "must be a finite number"
            )
        if column.place is None:
            arrays[column.array] = values
        else:
            arrays.setdefault(column.array, []).append(values)
    arrays = {
        name: np.stack(values, axis=1) if isinstance(values, list) else values
        for name, values in arrays.items()
    }
    if isinstance(protocol, SingleContact):
        contacts = arrays.pop("segment")[:, None] == np.arange(1, stored.segment_count + 1)
        # a row without contact keeps its values, for the check of labels
        kept = contacts | ~contacts.any(axis=1, keepdims=True)
        for array, name in (("angles_deg", "angle_deg"), ("magnitudes_n", "magnitude_n")):
            arrays[array] = np.where(kept, arrays.pop(name)[:, None], 0.0)
        arrays["contacts"] = contacts
    if not protocol.anywhere:  # at the arm's contact points
        arrays["places_m"] = np.where(arrays["contacts"], protocol.touched_m(stored)[:, 0], 0.0)
        arrays["along_n"] = np.zeros_like(arrays["places_m"])
    dataset = Dataset(arm=stored, protocol=protocol, seed=seed, **arrays)
    _require_possible_labels(path, dataset)
    return dataset


def _read_table(path: Path) -> pa.Table:
    try:
        if path.exists() and not path.is_file():  # a pipe would keep an open waiting
            raise DatasetError(f"{path}: not a Parquet file, nor a file at all")
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            rows = file.metadata.num_rows
            width = file.metadata.num_columns
            # a few bytes of Parquet can stand for any number of equal rows; no measured ones do
            packed = path.stat().st_size
            if 8 * rows * width > _LARGEST_UNPACKED_B + _MAX_UNPACKING * packed:
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


def _provenance(path: Path, schema: pa.Schema) -> tuple[Arm, Protocol, int]:
    """Arm, protocol and seed from the metadata; the columns must be theirs."""
    metadata = {
        key.decode().removeprefix(_PREFIX): value.decode(errors="replace")
        for key, value in (schema.metadata or {}).items()
        if key.startswith(_PREFIX.encode())
    }
    if "format" not in metadata:
        raise DatasetError(
            f"{path}: a Parquet file, but not a CableSense dataset (its metadata lacks "
            f"{_PREFIX}format); `cablesense dataset` writes one"
        )
    if metadata["format"] != _FORMAT:
        raise DatasetError(
            f"{path}: format {metadata['format']!r}; this version reads format {_FORMAT!r}"
        )
    try:
        arm = parse_arm(metadata["arm"], source=f"{path}, {_PREFIX}arm")
        protocol = protocol_from_options(json.loads(metadata["protocol"]))
        seed = int(metadata["seed"])
    except ArmFileError as error:
        raise DatasetError(str(error)) from error
    except (KeyError, ValueError, TypeError, RecursionError, DatasetError) as error:
        raise DatasetError(f"{path}: {_PREFIX}protocol or {_PREFIX}seed: {error}") from error
    if metadata.get("arm_identity") != arm.identity:
        raise DatasetError(
            f"{path}: {_PREFIX}arm_identity = {metadata.get('arm_identity')}, but the arm it "
            f"describes is {arm.identity}; the metadata was altered, generate the dataset again"
        )
    for stored, column in zip_longest(schema, _columns(arm, protocol)):
        right = column and column.field
        if stored is None or right is None or not stored.equals(right, check_metadata=True):
            raise DatasetError(
                f"{path}: has column {_shown(stored)} where arm {arm.identity} and its protocol "
                f"need {_shown(right)}; generate it again"
            )
    return arm, protocol, seed


def _shown(field: pa.Field | None) -> str:
    if field is None:
        return "none"
    unit = (field.metadata or {}).get(b"unit", b"no unit").decode(errors="replace")
    return f"{field.name[:60]!r} of {field.type} in {unit[:20]!r}"


def _require_possible_labels(path: Path, dataset: Dataset) -> None:
    contacts = dataset.contacts
    force = dataset.magnitudes_n
    angle = dataset.angles_deg
    place = dataset.places_m
    along = dataset.along_n
    low = dataset.protocol.force_low_n
    high = dataset.protocol.force_high_n
    possible = (force >= low) & (force <= high) & (angle >= 0.0) & (angle < 360.0)
    untouched = (force == 0.0) & (angle == 0.0) & (place == 0.0) & (along == 0.0)
    wrong = np.argwhere(~np.where(contacts, possible, untouched))
    if len(wrong):
        row, n = wrong[0]
        what = "a contact" if contacts[row, n] else "no contact"
        raise DatasetError(
            f"{path}: row {row} has {what} of {force[row, n]} N at {angle[row, n]} degrees; a "
            f"contact has {low:g} to {high:g} N and 0 to below 360 degrees, none has 0 of both"
        )
    near, far = dataset.protocol.touched_m(dataset.arm).T
    wrong = np.argwhere(contacts & ~((place >= near) & (place <= far)))
    if len(wrong):
        row, n = wrong[0]
        raise DatasetError(
            f"{path}: row {row} has a contact at {place[row, n]} m from the joint of segment "
            f"{n + 1}; it can be touched from {near[n]:g} to {far[n]:g} m"
        )


def write_dataset(path: str | Path, dataset: Dataset, command: str = "") -> None:
    """Write a dataset, with the command that makes it, to a file that appears when it is whole.

    Raises:
        DatasetError: the file cannot be written.
    """
    rows = _CHUNKS_PER_GROUP * CHUNK_SAMPLES
    groups = (dataset.select(slice(first, first + rows)) for first in range(0, len(dataset), rows))
    run = dataset.arm, dataset.protocol, dataset.seed
    deque(_written(path, groups, *run, command), maxlen=0)


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

        def groups() -> Iterator[Dataset]:
            while group := list(islice(chunks, _CHUNKS_PER_GROUP)):
                yield Dataset.concatenate(group)
                advance(sum(map(len, group)))

        return summarise(_written(path, groups(), arm, protocol, seed, command))


def _written(
    path: str | Path,
    groups: Iterable[Dataset],
    arm: Arm,
    protocol: Protocol,
    seed: int,
    command: str,
) -> Iterator[Dataset]:
    """Write the parts of one run, a row group each, and hand them on; on any failure no file."""
    columns = _columns(arm, protocol)
    metadata = {
        "format": _FORMAT,
        "arm_identity": arm.identity,
        "arm": yaml.safe_dump(arm.model_dump(), sort_keys=False),
        "cables": json.dumps(arm.cable_names),
        "joints": json.dumps(arm.joint_names),
        "protocol": json.dumps(protocol.options(), sort_keys=True),
        "seed": str(seed),
        "version": package_version(),
        "command": command,
    }
    schema = pa.schema(
        [column.field for column in columns],
        metadata={_PREFIX + key: text for key, text in metadata.items()},
    )
    with (
        written_whole(path, DatasetError) as beside,
        pq.ParquetWriter(beside, schema, compression="zstd", write_page_checksum=True) as writer,
    ):
        for group in groups:
            values = []
            for column in columns:
                whole = getattr(group, column.array)
                part = whole if column.place is None else whole[:, column.place].copy()
                values.append(pa.array(part, type=column.field.type))
            writer.write_table(pa.table(values, schema=schema), row_group_size=len(group))
            yield group
