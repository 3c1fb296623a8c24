"""Writes the statement on a machine's contacts as one ONNX file: no training, some seconds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import torch
from torch import Tensor

from cablesense_base import Array
from cablesense_base.files import write_atomically
from cablesense_base.installation import package_version
from cablesense_contact.inference.session import open_session
from cablesense_contact.machine.law import EVIDENCE, STATED, evidence_of
from cablesense_contact.machine.model_file import MachineMetadata
from cablesense_contact.machine.observation import Observer
from cablesense_sim.machine.description import MachineError
from cablesense_sim.machine.machine import Machine
from cablesense_sim.machine.simulated import AtRest, SimulatedMachine
from cablesense_sim.machine.statics import LinkForce
from cablesense_training.errors import TrainingError
from cablesense_training.export import TRACED_ROWS, to_onnx
from cablesense_training.law.evidence import Evidence
from cablesense_training.law.machine import machine_statement
from cablesense_training.law.statement import ContactStatement
from cablesense_training.law_export import require_agreement

_TRIAL_ROWS = 12
"""On which an exported statement is compared with the original."""
_PUSH_SHARE = 0.05
"""Of these the forces, as a share of the largest that is expected."""
_BORNE_SHARES = (1.0, 0.3, 0.1, 0.03, 0.01)
"""Of these forces what is tried, until the machine bears it."""


class _Traced(torch.nn.Module):
    """A statement with its evidence as separate inputs, as the exporter wants them."""

    def __init__(self, statement: ContactStatement) -> None:
        super().__init__()
        self.statement = statement

    def forward(self, *evidence: Tensor) -> tuple[Tensor, ...]:
        return tuple(self.statement(Evidence._make(evidence)))


def export_machine(machine: Machine, path: Path, command: str) -> None:
    """Write the model file of a machine; it answers as PyTorch does, which is checked.

    Raises:
        MachineError: the machine does not bear its own weight, or a small push.
        TrainingError: PyTorch and ONNX Runtime differ, or the file cannot be written.
    """
    statement = _Traced(machine_statement(machine)).double().eval()
    trial = _trial(machine)
    rows = np.arange(TRACED_ROWS) % _TRIAL_ROWS
    traced = {name: torch.as_tensor(trial[name][rows]) for name in EVIDENCE}
    model = to_onnx(statement, traced, STATED)
    metadata = MachineMetadata(
        identity=machine.identity,
        channel_names=machine.channels.names,
        joint_names=machine.coordinates.names,
        link_names=machine.links.names,
        command=command,
        version=package_version(),
    )
    onnx.helper.set_model_props(model, metadata.to_properties())
    onnx.checker.check_model(model, full_check=False)
    _require_agreement(statement, model, trial)
    write_atomically(path, model.SerializeToString(), TrainingError)


def _trial(machine: Machine) -> dict[str, Array]:
    """Evidence of some rows: the machine as modelled, pushed at each link in turn."""
    observer = Observer(machine)
    parameters = observer.parameters
    rng = np.random.default_rng(0)
    covariance = np.diag(parameters.prior_std**2)
    count = len(machine.coordinates)
    still = np.zeros((count, count))
    command = observer.command_of(machine.reference)
    nominal = SimulatedMachine(machine, parameters, 0.0 * parameters.prior_mean)
    untouched = nominal.untouched(command)
    push_n = _PUSH_SHARE * machine.source.file.touch.largest_n
    observed = []
    for row in range(_TRIAL_ROWS):
        link = row % len(machine.links.names)
        point_m = np.array([machine.links.touched_m[link].mean(), 0.0, 0.0])
        force = LinkForce(link, point_m, push_n * rng.normal(size=3))
        touched = _touched_as_borne(nominal, command, force, untouched)
        reading = machine.channels.read(touched.values, rng)
        seen = observer.observe(reading, command, parameters.prior_mean, covariance, still)
        observed.append(seen)
    return evidence_of(observed, machine.source.file.touch.largest_n)


def _touched_as_borne(
    nominal: SimulatedMachine, command: Array, force: LinkForce, untouched: AtRest
) -> AtRest:
    """The machine at rest under a force, or under what it bears of it.

    Raises:
        MachineError: it does not bear a hundredth.
    """
    *larger, least = (replace(force, force_n=share * force.force_n) for share in _BORNE_SHARES)
    for borne in larger:
        try:
            return nominal.touched(command, [borne], untouched)
        except MachineError:
            continue
    return nominal.touched(command, [least], untouched)


def _require_agreement(
    statement: _Traced, model: onnx.ModelProto, trial: dict[str, Array]
) -> None:
    by_runtime = open_session(model).run(None, trial)
    with torch.no_grad():
        by_torch = statement(*(torch.as_tensor(trial[name]) for name in EVIDENCE))
    for name, computed, expected in zip(STATED, by_runtime, by_torch, strict=True):
        require_agreement(name, computed, expected.numpy())
