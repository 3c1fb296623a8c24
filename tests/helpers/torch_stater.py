"""The statement on a machine's contacts in PyTorch, without a model file."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

from cablesense_base import Array
from cablesense_contact.machine.law import EVIDENCE, STATED
from cablesense_sim.machine.machine import Machine
from cablesense_training.law.evidence import Evidence
from cablesense_training.law.machine import machine_statement


class TorchStater:
    """The statement in PyTorch; a `cablesense_contact.machine.law.Stater`."""

    def __init__(self, machine: Machine) -> None:
        self._statement = machine_statement(machine).double().eval()

    def __call__(self, evidence: Mapping[str, Array]) -> Mapping[str, Any]:
        """See `Stater`."""
        inputs = [torch.as_tensor(np.asarray(evidence[name])) for name in EVIDENCE]
        with torch.no_grad():
            stated = self._statement(Evidence._make(inputs))
        return {name: value.numpy() for name, value in zip(STATED, stated, strict=True)}
