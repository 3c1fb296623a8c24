"""Writes a trained network as one ONNX file, from tension differences to answers in units."""

from __future__ import annotations

import contextlib
import io
import logging
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import onnx
import torch
from torch import Tensor, nn

from cablesense_base.files import write_atomically
from cablesense_contact.inference.estimator import MULTI_OUTPUTS, OUTPUTS
from cablesense_contact.inference.metadata import ModelMetadata
from cablesense_contact.inference.session import input_widths, open_session
from cablesense_training.errors import TrainingError
from cablesense_training.networks.layers import ContactNetwork

OPSET = 20
"""Of ONNX, of all exported models."""

AGREEMENT = 1e-5
"""Largest difference allowed between PyTorch and ONNX Runtime, as it is or as a share."""

_TRIAL_ROWS = 64
"""On which an exported network is compared with the original."""
TRACED_ROWS = 10007
"""A prime larger than any other size in a network: no product of these is a multiple of it."""

_SHORT_CONSTANT = 64
"""Shorter constants are not worth a cast."""


def export_model(network: ContactNetwork, path: Path, metadata: ModelMetadata) -> None:
    """Write a trained network as an ONNX file in float64 that answers as PyTorch does, checked.

    Raises:
        TrainingError: PyTorch and ONNX Runtime differ by more than `AGREEMENT`, or the folder
            cannot be written.
    """
    answers = _Answers(network).double().eval()
    inputs = dict(zip(input_widths(metadata), _trial_inputs(metadata), strict=True))
    rows = torch.arange(TRACED_ROWS) % _TRIAL_ROWS
    traced = {name: value[rows] for name, value in inputs.items()}
    model = to_onnx(answers, traced, answers.outputs)
    onnx.helper.set_model_props(model, metadata.to_properties())
    store_as_single(model.graph)
    onnx.checker.check_model(model, full_check=False)
    _require_agreement(answers, model, inputs)
    write_atomically(path, model.SerializeToString(), TrainingError)


class _Answers(nn.Module):
    """A network with answers in their units, and the names of these `outputs`."""

    def __init__(self, network: ContactNetwork) -> None:
        super().__init__()
        self.network = network
        self.outputs: Sequence[str] = MULTI_OUTPUTS if network.several else OUTPUTS

    def forward(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        if self.network.several:
            logits, *forces = self.network(*inputs)
            return torch.sigmoid(logits), *forces
        output = self.network(*inputs)
        # a small addend would do as well, did the exporter not leave out what it takes for 0
        squared = (output.direction * output.direction).sum(-1, keepdim=True)
        length = torch.sqrt(squared).clamp(min=1e-9)
        output = output._replace(direction=output.direction / length)
        return torch.softmax(output.contact_logits, dim=-1), *output[1:]


def _trial_inputs(metadata: ModelMetadata) -> list[Tensor]:
    rng = np.random.default_rng(0)
    rows = (_TRIAL_ROWS, metadata.arm.cable_count)
    tension = torch.as_tensor(rng.normal(0.0, 0.1 * metadata.force_range_n, rows))
    tension[0] = 0.0  # where one zero may be divided by another
    if not metadata.pose_aware:
        return [tension]
    reach = np.deg2rad(metadata.pose_range_deg)
    command = rng.uniform(-reach, reach, (_TRIAL_ROWS, metadata.arm.joint_count))
    return [tension, torch.as_tensor(command)]


def to_onnx(
    module: nn.Module, traced: Mapping[str, Tensor], outputs: Sequence[str]
) -> onnx.ModelProto:
    """The graph of a module, traced for `TRACED_ROWS` samples and made to take any number.

    With that number as a symbol tracing takes more than twice as long.

    Args:
        module: gives a tuple, in the order of the names of its `outputs`.
        traced: inputs by name, those of samples with `TRACED_ROWS` rows.
        outputs: see `module`.
    """
    with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        logging.getLogger("torch.onnx").setLevel(logging.ERROR)
        program = torch.onnx.export(
            module,
            tuple(traced.values()),
            dynamo=True,
            opset_version=OPSET,
            input_names=list(traced),
            output_names=list(outputs),
            verbose=False,
        )
    assert program is not None
    model = program.model_proto
    for node in model.graph.node:
        del node.metadata_props[:]
        node.doc_string = ""
    del model.metadata_props[:]
    _take_any_number_of_rows(model.graph)
    return model


def _take_any_number_of_rows(graph: onnx.GraphProto) -> None:
    """Take `TRACED_ROWS` out of shapes, and out of constants, which are one row for all samples.

    A graph that contains it elsewhere fails on the trial's rows.
    """
    del graph.value_info[:]
    for entry in (*graph.input, *graph.output):
        for dimension in entry.type.tensor_type.shape.dim:
            if dimension.dim_value == TRACED_ROWS:
                dimension.dim_param = "batch"
    shapes = {node.input[1] for node in graph.node if node.op_type == "Reshape"}
    for constant in graph.initializer:
        values = onnx.numpy_helper.to_array(constant)
        if constant.name in shapes:
            several = (values > 0) & (values % TRACED_ROWS == 0)
            values = np.where(several, -1, values)
        elif values.shape[:1] == (TRACED_ROWS,) and (values == values[:1]).all():
            values = values[:1]
        else:
            continue
        constant.CopyFrom(onnx.numpy_helper.from_array(values, constant.name))


def store_as_single(graph: onnx.GraphProto) -> None:
    """Store constants in float32 where that loses nothing, each followed by a cast to float64.

    A network is trained in float32 and answers in float64, so this halves its file.
    """
    casts = []
    kept = []
    for constant in graph.initializer:
        values = onnx.numpy_helper.to_array(constant)
        single = values.astype(np.float32)
        if (
            values.dtype != np.float64
            or values.size < _SHORT_CONSTANT
            or not (single == values).all()
        ):
            kept.append(constant)
            continue
        stored = onnx.numpy_helper.from_array(single, f"{constant.name}_single")
        kept.append(stored)
        casts.append(
            onnx.helper.make_node(
                "Cast", [stored.name], [constant.name], to=onnx.TensorProto.DOUBLE
            )
        )
    nodes = [*casts, *graph.node]
    del graph.initializer[:]
    del graph.node[:]
    graph.initializer.extend(kept)
    graph.node.extend(nodes)


def _require_agreement(
    answers: nn.Module, model: onnx.ModelProto, inputs: dict[str, Tensor]
) -> None:
    session = open_session(model)
    computed = session.run(None, {name: value.numpy() for name, value in inputs.items()})
    with torch.no_grad():
        expected = answers(*inputs.values())
    for entry, by_runtime, by_torch in zip(session.get_outputs(), computed, expected, strict=True):
        if not np.isfinite(by_runtime).all():
            raise TrainingError(f"output {entry.name} is not finite in ONNX Runtime")
        # at rest, in the first row, the direction is that of a rounding error
        off = np.abs(by_runtime - by_torch.numpy()).reshape(len(by_runtime), -1).max(axis=1)
        scale = np.maximum(1.0, np.abs(by_runtime).reshape(len(by_runtime), -1).max(axis=1))
        difference = float((off / scale)[1:].max())
        if not difference <= AGREEMENT:
            raise TrainingError(
                f"output {entry.name} differs by {difference:.2g} between PyTorch and ONNX "
                f"Runtime; at most {AGREEMENT:g} is allowed"
            )
