"""Datasets, networks, training, evaluation, model files and the estimator that runs them.

What a user takes from here; each name is imported when it is first asked for, so that an estimator
needs no PyTorch and a dataset in memory no Parquet library::

    estimator = open_estimator(find_model("cdsm"), load_arm("my_arm.yaml"))
    contact = estimator.estimate(tension_difference_n, joint_command_rad)
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cablesense_training.data.dataset import Dataset
    from cablesense_training.data.generation import draw_dataset
    from cablesense_training.data.parquet import read_dataset, write_dataset
    from cablesense_training.data.protocols import MultiContact, SingleContact
    from cablesense_training.errors import DatasetError, TrainingError
    from cablesense_training.inference.estimator import (
        Estimate,
        Estimates,
        Estimator,
        MultiEstimator,
    )
    from cablesense_training.inference.metadata import ModelFileError, find_model
    from cablesense_training.inference.temporal_estimator import (
        TemporalEstimator,
        open_estimator,
    )
    from cablesense_training.train_model import draw_training_data, train_model

_MODULES = {
    "data.dataset": ("Dataset",),
    "data.generation": ("draw_dataset",),
    "data.parquet": ("read_dataset", "write_dataset"),
    "data.protocols": ("MultiContact", "SingleContact"),
    "errors": ("DatasetError", "TrainingError"),
    "inference.estimator": ("Estimate", "Estimates", "Estimator", "MultiEstimator"),
    "inference.metadata": ("ModelFileError", "find_model"),
    "inference.temporal_estimator": ("TemporalEstimator", "open_estimator"),
    "train_model": ("draw_training_data", "train_model"),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}

__all__ = [
    "Dataset",
    "DatasetError",
    "Estimate",
    "Estimates",
    "Estimator",
    "ModelFileError",
    "MultiContact",
    "MultiEstimator",
    "SingleContact",
    "TemporalEstimator",
    "TrainingError",
    "draw_dataset",
    "draw_training_data",
    "find_model",
    "open_estimator",
    "read_dataset",
    "train_model",
    "write_dataset",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
