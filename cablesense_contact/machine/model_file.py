"""The model file of a machine: the graph that states contacts, and which machine it is for."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from pydantic import BaseModel, ConfigDict, ValidationError

from cablesense_base import Array
from cablesense_contact.errors import ModelFileError
from cablesense_contact.inference.model_file import one_line, read_graph
from cablesense_contact.inference.session import EXPORT_AGAIN, cannot_run, open_session
from cablesense_contact.machine.law import EVIDENCE, STATED, MachineLaw
from cablesense_sim.machine.machine import Machine
from cablesense_sim.machine.simulated import SimulatedMachine

FORMAT = "cablesense-machine-model/1"
"""Name and version of the format; a reader refuses any other."""

_KEY = "cablesense_machine"


class MachineMetadata(BaseModel):
    """Purpose and origin of a machine's model; one JSON text in the ONNX file's metadata.

    Attributes:
        identity: of the machine.
        channel_names, joint_names, link_names: in the order of the graph's sizes.
        command: what makes the file again.
        version: of CableSense.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    format: str = FORMAT
    identity: str
    channel_names: tuple[str, ...]
    joint_names: tuple[str, ...]
    link_names: tuple[str, ...]
    command: str
    version: str

    def to_properties(self) -> dict[str, str]:
        """As ONNX metadata properties."""
        return {_KEY: json.dumps(self.model_dump(mode="json"), sort_keys=True)}


class GraphStater:
    """The graph of a model file; a `law.Stater`."""

    def __init__(self, model: onnx.ModelProto, source: str) -> None:
        self._source = source
        try:
            self._session = open_session(model)
        except Exception as error:  # ONNX Runtime and onnx raise a family of their own each
            raise cannot_run(self._source, error, EXPORT_AGAIN) from error

    def __call__(self, evidence: Mapping[str, Array]) -> Mapping[str, Any]:
        """What is stated, arrays by the names `STATED`, of evidence by the names `EVIDENCE`.

        Raises:
            ModelFileError: ONNX Runtime cannot run it.
        """
        try:
            stated = self._session.run(None, dict(evidence))
        except Exception as error:  # ONNX Runtime's classes have no common base
            raise cannot_run(self._source, error, EXPORT_AGAIN) from error
        return dict(zip(STATED, stated, strict=True))


def open_machine_law(path: str | Path, machine: Machine) -> MachineLaw:
    """The law of a machine, by its model file.

    Raises:
        ModelFileError: the file is no such model, or one of another machine.
    """
    model, properties = read_graph(path)
    if _KEY not in properties:
        raise ModelFileError(
            f"{path}: no model of a machine that MuJoCo describes; make one with `cablesense "
            f"export --arm {machine.source.path}`"
        )
    try:
        metadata = MachineMetadata.model_validate(json.loads(properties[_KEY]))
    except (ValueError, ValidationError, RecursionError) as error:
        raise ModelFileError(
            f"{path}: its metadata cannot be read ({one_line(error)}); make it again with "
            "`cablesense export`"
        ) from error
    if metadata.format != FORMAT or metadata.identity != machine.identity:
        raise ModelFileError(
            f"{path}: made for {metadata.identity[:80]}, not for {machine.identity}; make it "
            f"again with `cablesense export --arm {machine.source.path}` (seconds)"
        )
    inputs = tuple(entry.name for entry in model.graph.input)
    outputs = tuple(entry.name for entry in model.graph.output)
    if inputs != EVIDENCE or outputs != STATED:
        raise ModelFileError(
            f"{path}: made by another version of CableSense; make it again with `cablesense "
            "export`"
        )
    law = MachineLaw(machine, GraphStater(model, str(path)))
    _require_answers(law, str(path))
    return law


def _require_answers(law: MachineLaw, source: str) -> None:
    """A file that opens may still not run; an idle machine shows it."""
    parameters = law.observer.parameters
    command = law.observer.command_of(law.machine.reference)
    nominal = SimulatedMachine(law.machine, parameters, 0.0 * parameters.prior_mean)
    reading = nominal.untouched(command).values
    count = len(law.machine.coordinates)
    seen = law(
        reading[None],
        command[None],
        parameters.prior_mean,
        np.diag(parameters.prior_std**2),
        np.zeros((count, count)),
    )
    if not all(np.isfinite(part).all() for part in seen):
        raise ModelFileError(
            f"{source}: its answer for an idle machine is not finite; make it again with "
            "`cablesense export`"
        )
