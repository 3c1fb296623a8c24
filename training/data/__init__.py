"""Datasets: the paper's protocols, their generation on any number of workers, and Parquet files.

The public surface::

    protocol = SingleContact(samples=5000, pose="random", pose_range_deg=10.0)
    dataset = Dataset.from_protocol(load_arm(path), protocol, seed=0)
    write_dataset("data.parquet", dataset)
    dataset = read_dataset("data.parquet", arm)

What reads or writes files is imported when it is first asked for: datasets in memory do without
the libraries for Parquet.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from cablesense_training.data.dataset import Dataset
from cablesense_training.data.generation import generate
from cablesense_training.data.protocols import (
    PROTOCOLS,
    MultiContact,
    Protocol,
    SingleContact,
    protocol_from_options,
)
from cablesense_training.errors import DatasetError

if TYPE_CHECKING:
    from cablesense_training.data.generation import dataset_command, produce_dataset
    from cablesense_training.data.parquet import read_dataset, write_dataset, write_parts

_WITH_FILES = {
    "dataset_command": "generation",
    "produce_dataset": "generation",
    "read_dataset": "parquet",
    "write_dataset": "parquet",
    "write_parts": "parquet",
}

__all__ = [
    "PROTOCOLS",
    "Dataset",
    "DatasetError",
    "MultiContact",
    "Protocol",
    "SingleContact",
    "dataset_command",
    "generate",
    "produce_dataset",
    "protocol_from_options",
    "read_dataset",
    "write_dataset",
    "write_parts",
]


def __getattr__(name: str) -> Any:
    if name not in _WITH_FILES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_WITH_FILES[name]}"), name)
