"""The model of a machine that MuJoCo describes, as the online estimator uses it.

A module of its own, as it needs MuJoCo, which the estimator of an arm does without.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from cablesense_contact.errors import ModelFileError
from cablesense_contact.machine.felt_model import FeltModel
from cablesense_contact.machine.law import MachineLaw
from cablesense_contact.machine.model_file import open_machine_law
from cablesense_contact.reference_contacts import ReferenceContacts
from cablesense_online.contacts import LawContacts
from cablesense_online.models import Loaded, ModelSummary, law_contacts
from cablesense_online.movable_machine import MovableMachine
from cablesense_online.settings import EstimationSettings
from cablesense_sim.machine.machine import Machine, open_machine


class LoadedMachine(Loaded):
    """The model of a machine."""

    def __init__(self, machine: Machine, law: MachineLaw, path: str) -> None:
        largest_n = machine.source.file.touch.largest_n
        self._felt = FeltModel(machine)
        summary = ModelSummary("anywhere", largest_n, np.inf)
        super().__init__(self._felt, machine, path, summary)
        self._law = law

    @property
    def law(self) -> MachineLaw:
        """The law in it."""
        return self._law

    @property
    def is_movable(self) -> bool:
        """Whether its joints or actuators are commanded, so that a commissioning can move it."""
        return not self._felt.source.is_measured

    def movable(self) -> MovableMachine:
        """The machine as a commissioning moves it.

        Raises:
            MachineError: its joints are measured.
        """
        return MovableMachine(self._felt)

    @property
    def reference_contacts(self) -> Callable[[], ReferenceContacts]:
        """Finds the machine at rest under pushes across every link."""
        return self._felt.reference_contacts

    def contacts(self, settings: EstimationSettings) -> LawContacts:
        """Finds contacts by the law."""
        return law_contacts(self.machine, self._law, settings)


def load_machine(path: str | Path, model: str = "") -> LoadedMachine:
    """A machine file with its model, which lies beside it as `.onnx` unless it is named.

    Raises:
        CableSenseError: a file is missing or invalid, or the model is of another machine.
    """
    machine = open_machine(path)
    model_path = Path(model) if model else Path(path).with_suffix(".onnx")
    if not model_path.is_file():
        raise ModelFileError(
            f"{model_path}: no such model file; make it with `cablesense export --arm {path} "
            f"--out {model_path}` (seconds)"
        )
    return LoadedMachine(machine, open_machine_law(model_path, machine), str(model_path))
