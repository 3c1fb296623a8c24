"""Datasets to Parquet files: streamed, whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from cablesense_sim.arm import Arm
from cablesense_training.data.dataset import Dataset
from cablesense_training.data.design import CHUNK_SAMPLES
from cablesense_training.data.errors import DatasetError
from cablesense_training.data.layout import Column, columns, schema
from cablesense_training.data.protocols import Protocol

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
        _beside(Path(path)) as beside,
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


@contextmanager
def _beside(path: Path) -> Iterator[Path]:
    """A new file in the same folder that becomes `path` if the block ends well, else vanishes."""
    beside = path.parent / f".{path.name}.{os.getpid()}.part"
    try:
        if path.is_dir():
            raise DatasetError(
                f"{path}: is a folder; give a file, such as {path / 'data.parquet'}"
            )
        beside.touch()
        try:
            yield beside
            beside.replace(path)
        finally:
            beside.unlink(missing_ok=True)
    except OSError as error:
        reason = error.strerror or " ".join(str(error).split())
        raise DatasetError(
            f"{path}: cannot be written ({reason}); "
            "give a file in a folder that exists and is yours"
        ) from error


def _values(dataset: Dataset, column: Column) -> pa.Array:
    values = getattr(dataset, column.array)
    if column.place is not None:
        values = np.ascontiguousarray(values[:, column.place])
    return pa.array(values, type=column.type)
