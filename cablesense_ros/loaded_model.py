"""The arm and the model that fits it, as the estimator node loads them."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from cablesense_sim.arm import Arm
from cablesense_sim.arm_files import open_arm
from cablesense_training.inference.estimator import Estimator
from cablesense_training.inference.model_files import find_model
from cablesense_training.inference.open_estimator import open_estimator
from cablesense_training.inference.temporal_estimator import TemporalEstimator


@dataclass(frozen=True)
class LoadedModel:
    """An estimator, the arm that it believes in, and the file that this came from."""

    arm: Arm
    estimator: Estimator | TemporalEstimator
    model: str

    @property
    def described(self) -> dict[str, str]:
        """The file and the SHA-256 of its content, for who must know which model answered."""
        with Path(self.model).open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        return {"model": self.model, "model SHA-256": digest}


def load_model(arm: str, model: str) -> LoadedModel:
    """Load by name or path; an empty `model` takes the bundled one of the arm's name.

    Raises:
        CableSenseError: a file is missing or invalid, or the model was made for another arm.
    """
    description = open_arm(arm)
    path = find_model(model or description.name)
    estimator = open_estimator(path, description)
    return LoadedModel(estimator.metadata.arm, estimator, str(path))
