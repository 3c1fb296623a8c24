"""A model as the online estimator uses it: found, opened, and the arm that it is for."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from cablesense_contact.calibration import Calibration
from cablesense_contact.calibration_file import read_calibration
from cablesense_contact.inference.estimator import Estimator, MultiEstimator
from cablesense_contact.inference.law_model import LawModel
from cablesense_contact.inference.metadata import ANYWHERE, ModelMetadata, find_model_of
from cablesense_contact.inference.model_file import read_model
from cablesense_online.calibrated_arm import CalibratedArm
from cablesense_online.contacts import LawContacts, NetworkContacts
from cablesense_online.settings import EstimationSettings
from cablesense_online.tared_arm import TaredArm
from cablesense_sim.arm import Arm, open_arm

AnyModel = LawModel | Estimator | MultiEstimator


@dataclass(frozen=True)
class LoadedModel:
    """A model, the arm that it is used for, and the file that it came from."""

    arm: Arm
    model: AnyModel
    path: str

    @classmethod
    def open(cls, path: Path, arm: Arm | None = None) -> LoadedModel:
        """Open a model file, for a certain arm where one is given.

        Raises:
            ModelFileError: it is no model, or one for another arm.
        """
        kind = read_model(path)[1].kind
        model: AnyModel
        if kind == ANYWHERE:
            model = LawModel(path, arm)
        elif kind == "multi-contact":
            model = MultiEstimator.load(path, arm)
        else:
            model = Estimator.load(path, arm)
        return cls(arm or model.metadata.arm, model, str(path))

    @property
    def metadata(self) -> ModelMetadata:
        """What the file states about itself."""
        return self.model.metadata

    @property
    def sha256(self) -> str:
        """Of the file, which identifies the model in a recording."""
        return hashlib.sha256(Path(self.path).read_bytes()).hexdigest()

    def contacts(self, settings: EstimationSettings) -> LawContacts | NetworkContacts:
        """Finds contacts by this model."""
        threshold = settings.contact_threshold
        hidden_above_n = settings.hidden_above_n
        if isinstance(self.model, LawModel):
            calibrated = CalibratedArm(self.arm, self.model, settings)
            return LawContacts(self.arm, self.model, calibrated, threshold, hidden_above_n)
        tared = TaredArm(self.arm, settings)
        return NetworkContacts(self.arm, self.model, tared, threshold, hidden_above_n)

    def calibration(self, path: str) -> Calibration | None:
        """The calibration in a file; None where none is named.

        Raises:
            CalibrationError: no calibration, or one of another arm.
        """
        return read_calibration(path, self.arm) if path else None


def load_model(arm: str, model: str) -> LoadedModel:
    """Load by name or path; an empty `model` takes the arm's bundled one (`find_model_of`).

    Raises:
        CableSenseError: a file is missing or invalid, or the model was made for another arm.
    """
    description = open_arm(arm)
    return LoadedModel.open(find_model_of(description, arm, model), description)
