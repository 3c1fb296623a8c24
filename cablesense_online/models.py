"""A model as the online estimator uses it: found, opened, and the machine that it is for."""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from cablesense_contact.calibration import Calibration
from cablesense_contact.calibration_file import read_calibration
from cablesense_contact.errors import ModelFileError
from cablesense_contact.felt import FeltMachine
from cablesense_contact.felt_arm import FeltArm
from cablesense_contact.inference.estimator import Estimator, MultiEstimator
from cablesense_contact.inference.law_model import LawModel
from cablesense_contact.inference.metadata import ANYWHERE, ModelMetadata, find_model_of
from cablesense_contact.inference.model_file import read_model
from cablesense_contact.law import Law
from cablesense_contact.reference_contacts import ReferenceContacts
from cablesense_online.calibrated_arm import CalibratedArm
from cablesense_online.contacts import ContactFinder, LawContacts, NetworkContacts
from cablesense_online.movable import Movable
from cablesense_online.settings import EstimationSettings
from cablesense_online.tared_arm import TaredArm
from cablesense_sim.arm import Arm, open_arm

if TYPE_CHECKING:
    from cablesense_recording.layout import Described

AnyModel = LawModel | Estimator | MultiEstimator


@dataclass(frozen=True)
class ModelSummary:
    """What diagnostics say of a model.

    Attributes:
        network: by which contacts are found, `anywhere` of the law.
        force_range_n: largest force that it is for.
        pose_range_deg: joint angles within ± this that it is for.
    """

    network: str
    force_range_n: float
    pose_range_deg: float


class Loaded(ABC):
    """A model file, opened, and the machine that it is used for.

    Attributes:
        machine: the machine.
        described: what recordings of it are read by.
        path: of the model file.
        summary: of the model.
    """

    def __init__(
        self, machine: FeltMachine, described: Described, path: str, summary: ModelSummary
    ) -> None:
        self.machine = machine
        self.described = described
        self.path = path
        self.summary = summary

    @cached_property
    def sha256(self) -> str:
        """Of the file, which identifies the model in a recording."""
        return hashlib.sha256(Path(self.path).read_bytes()).hexdigest()

    @abstractmethod
    def contacts(self, settings: EstimationSettings) -> ContactFinder:
        """Finds contacts by this model."""

    @property
    @abstractmethod
    def law(self) -> Law | None:
        """The law in it; None of a network."""

    @property
    @abstractmethod
    def is_movable(self) -> bool:
        """Whether a commissioning can move it: it has a law, and something here commands it."""

    @abstractmethod
    def movable(self) -> Movable:
        """The machine as a commissioning moves it.

        Raises:
            CableSenseError: it is not (`is_movable`).
        """

    @property
    @abstractmethod
    def reference_contacts(self) -> Callable[[], ReferenceContacts]:
        """Finds the machine under contacts that stand for all."""

    def calibration(self, path: str) -> Calibration | None:
        """The calibration in a file; None where none is named.

        Raises:
            CalibrationError: no calibration, or one of another machine.
        """
        return read_calibration(path, self.machine) if path else None


class LoadedModel(Loaded):
    """The model of an arm.

    Attributes:
        arm: the arm.
        model: the model.
    """

    def __init__(self, arm: Arm, model: AnyModel, path: str) -> None:
        metadata = model.metadata
        summary = ModelSummary(metadata.network, metadata.force_range_n, metadata.pose_range_deg)
        super().__init__(FeltArm(arm), arm, path, summary)
        self.arm = arm
        self.model = model

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
    def law(self) -> LawModel | None:
        """The law in it; None of a network."""
        return self.model if isinstance(self.model, LawModel) else None

    @property
    def is_movable(self) -> bool:
        """Whether a commissioning can move it: not by a network, which takes no calibration."""
        return self.law is not None

    def movable(self) -> Movable:
        """The arm as a commissioning moves it.

        Raises:
            ModelFileError: the model is a network.
        """
        from cablesense_online.movable_arm import MovableArm

        law = self.law
        if law is None:
            raise ModelFileError(
                f"{self.path}: a commissioning needs a model of contacts anywhere; make one with "
                "`cablesense export`"
            )
        return MovableArm(self.arm, law)

    @property
    def reference_contacts(self) -> Callable[[], ReferenceContacts]:
        """Finds the arm at rest under pushes across every segment, in several poses."""
        return lambda: ReferenceContacts.of_arm(self.arm)

    def contacts(self, settings: EstimationSettings) -> LawContacts | NetworkContacts:
        """Finds contacts by the law, or by the network."""
        if isinstance(self.model, LawModel):
            return law_contacts(self.machine, self.model, settings)
        tared = TaredArm(self.arm, settings)
        threshold = settings.contact_threshold
        return NetworkContacts(self.arm, self.model, tared, threshold, settings.hidden_above_n)


def law_contacts(machine: FeltMachine, law: Law, settings: EstimationSettings) -> LawContacts:
    """Contacts by the law of a machine."""
    calibrated = CalibratedArm(machine, law, settings)
    threshold = settings.contact_threshold
    return LawContacts(machine, law, calibrated, threshold, settings.hidden_above_n)


def load_model(arm: str, model: str) -> LoadedModel:
    """Load by name or path; an empty `model` takes the arm's bundled one (`find_model_of`).

    Raises:
        CableSenseError: a file is missing or invalid, or the model was made for another arm.
    """
    description = open_arm(arm)
    return LoadedModel.open(find_model_of(description, arm, model), description)
