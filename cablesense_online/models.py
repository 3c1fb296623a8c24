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
from cablesense_msgs_py.messages import Level, Status
from cablesense_online.contacts import LawContacts, NetworkContacts
from cablesense_online.settings import EstimationSettings
from cablesense_online.tare import CalibratedArm, TaredArm, TareError
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

    def contacts(
        self, settings: EstimationSettings, calibration: Calibration | None = None
    ) -> LawContacts | NetworkContacts:
        """Finds contacts by this model, on an arm as well known as a calibration says.

        Raises:
            TareError: a calibration is given with a network.
        """
        threshold = settings.contact_threshold
        if isinstance(self.model, LawModel):
            known = CalibratedArm(self.arm, self.model, settings, calibration)
            return LawContacts(self.arm, self.model, known, threshold, settings.hidden_above_n)
        if calibration is not None:
            raise TareError(f"{self.path}: is a network, which takes no calibration")
        tared = TaredArm(self.arm, settings)
        hidden_above_n = settings.hidden_above_n
        return NetworkContacts(self.arm, self.model, tared, threshold, hidden_above_n)

    def calibration(self, path: str) -> Calibration | None:
        """The calibration in a file; None where none is named.

        Raises:
            CalibrationError: no calibration, or one of another arm.
        """
        return read_calibration(path, self.arm) if path else None

    def status(self, largest_force_n: float, active: bool) -> Status:
        """The model in use, for diagnostics, with the largest force since the last report."""
        metadata = self.metadata
        values = {
            "model": self.path,
            "network": metadata.network,
            "arm": self.arm.identity,
            "up to (N)": f"{metadata.force_range_n:g}",
            "largest force (N)": f"{largest_force_n:.1f}",
        }
        if not active:
            return Status("model", Level.WARN, "configured, not active", values)
        if largest_force_n > metadata.force_range_n:
            return Status("model", Level.WARN, "forces beyond those that it is for", values)
        return Status("model", Level.OK, "active", values)


def load_model(arm: str, model: str) -> LoadedModel:
    """Load by name or path; an empty `model` takes the arm's bundled one (`find_model_of`).

    Raises:
        CableSenseError: a file is missing or invalid, or the model was made for another arm.
    """
    description = open_arm(arm)
    return LoadedModel.open(find_model_of(description, arm, model), description)
