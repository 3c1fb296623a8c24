"""Any single-contact model file, opened as what it is."""

from __future__ import annotations

from pathlib import Path

from cablesense_sim.arm import Arm
from cablesense_training.inference.estimator import Estimator
from cablesense_training.inference.session import read_model
from cablesense_training.inference.temporal_estimator import TemporalEstimator


def open_estimator(path: str | Path, arm: Arm | None = None) -> Estimator | TemporalEstimator:
    """The estimator in a model file, with or without memory, for a certain arm where one is given.

    Raises:
        ModelFileError: the file is no single-contact model, or not one for this arm.
    """
    _, metadata = read_model(path)
    return (TemporalEstimator if metadata.memory else Estimator).load(path, arm)
