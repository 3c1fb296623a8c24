"""Models of single contacts, whichever of the two kinds a file holds."""

from __future__ import annotations

from pathlib import Path

from cablesense_contact.inference.estimator import Estimator
from cablesense_contact.inference.law_model import LawModel
from cablesense_contact.inference.metadata import ANYWHERE
from cablesense_contact.inference.model_file import read_model
from cablesense_sim.arm import Arm


def open_estimator(path: str | Path, arm: Arm | None = None) -> LawModel | Estimator:
    """Open the law, or a network of one contact, for a certain arm where one is given.

    Raises:
        ModelFileError: the file is neither, or not for this arm.
    """
    if read_model(path)[1].kind == ANYWHERE:
        return LawModel(path, arm)
    return Estimator.load(path, arm)
