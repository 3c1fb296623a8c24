"""Model files, changed as bytes, in their metadata and in their graphs."""

from __future__ import annotations

import json
import random
from pathlib import Path

import numpy as np
import onnx
from onnx import AttributeProto, ModelProto, helper

from cablesense_training.inference.estimator import Estimator
from cablesense_training.inference.model_files import find_model
from fuzz.byte_mutation import mutated_bytes
from fuzz.file_item import file_run
from fuzz.target import FalseAnswerError, Run
from fuzz.text_mutation import mutated_text

_NAMES = ("cdsm_tensions_only", "peers/cdsm_straight_two_stage", "peers/cdsm_closed_form", "cdsm")
_WEIGHTS = (4, 4, 2, 1)
_OPERATORS = (
    "Loop", "If", "Scan", "NonZero", "Identity", "MatMul", "Reshape", "Gather", "Slice", "Pad",
    "Expand", "Tile", "Split", "Concat", "Transpose", "Softmax", "GRU", "Conv", "Range", "ArgMax",
    "Einsum", "Resize", "ConstantOfShape", "ScatterND", "StringSplit", "",
)  # fmt: skip
_INTEGERS = (0, 1, -1, 2, 7, 100, 2**20, 2**31, -(2**31), 2**40, 2**62, -(2**63), 2**63 - 1)


def make_models(seed: int) -> Run:
    """Of four bundled models; the smaller ones more often."""
    contents = [find_model(name).read_bytes() for name in _NAMES]

    def make(rng: random.Random, item: int) -> tuple[bytes, str]:
        content = rng.choices(contents, _WEIGHTS)[0]
        if item % 3 == 0:
            return mutated_bytes(rng, content, contents), ".onnx"
        model = onnx.load_model_from_string(content)
        for _ in range(rng.choice((1, 1, 2, 3))):
            rng.choice(_CHANGES)(rng, model)
        return model.SerializeToString(), ".onnx"

    return file_run("models", seed, make, _use)


def _use(path: Path) -> None:
    estimator = Estimator.load(path)
    command = np.zeros(estimator.metadata.arm.joint_count)
    for scale in (0.0, 1.0, 50.0):
        row = np.linspace(-scale, scale, len(estimator.cable_names))
        said = estimator.estimate(row, command)
        numbers = [*said.probabilities, *said[2:]]
        if not np.isfinite(numbers).all():
            raise FalseAnswerError(f"a model answers {said}")


def _node(rng: random.Random, model: ModelProto) -> None:
    node = rng.choice(model.graph.node)
    action = rng.randrange(6)
    if action == 0:
        node.op_type = rng.choice(_OPERATORS)
    elif action == 1:
        node.domain = rng.choice(("", "ai.onnx", "com.microsoft", "ai.onnx.ml", "x", "\0"))
    elif action == 2 and node.input:
        names = [name for other in model.graph.node for name in other.output]
        node.input[rng.randrange(len(node.input))] = rng.choice((*names, "", "nowhere"))
    elif action == 3 and node.input:
        del node.input[rng.randrange(len(node.input)) :]
    elif action == 4:
        node.output.append(rng.choice(("", "more", *node.output)))
    else:
        model.graph.node.remove(node)


def _attribute(rng: random.Random, model: ModelProto) -> None:
    node = rng.choice([n for n in model.graph.node if n.attribute] or model.graph.node)
    if not node.attribute or rng.random() < 0.2:
        name = rng.choice(("axis", "axes", "perm", "to", "value", "then_branch", "hidden_size"))
        node.attribute.append(helper.make_attribute(name, rng.choice(_INTEGERS)))
        return
    attribute = rng.choice(node.attribute)
    if attribute.type == AttributeProto.INT:
        attribute.i = rng.choice(_INTEGERS)
    elif attribute.type == AttributeProto.INTS:
        attribute.ints[:] = rng.choices(_INTEGERS, k=rng.choice((0, 1, 2, 9)))
    else:
        attribute.type = rng.randrange(15)  # type: ignore[assignment]


def _tensor(rng: random.Random, model: ModelProto) -> None:
    tensor = rng.choice(model.graph.initializer)
    action = rng.randrange(6)
    if action == 0 and tensor.dims:
        tensor.dims[rng.randrange(len(tensor.dims))] = rng.choice(_INTEGERS)
    elif action == 1:
        tensor.data_type = rng.randrange(30)
    elif action == 2:
        tensor.raw_data = mutated_bytes(rng, tensor.raw_data, most=2)
    elif action == 3:
        tensor.external_data.add(key="location", value="/etc/passwd")
        tensor.data_location = rng.choice((0, 1))  # type: ignore[assignment]
    elif action == 4:
        tensor.dims.append(rng.choice(_INTEGERS))
    else:
        values = np.frombuffer(tensor.raw_data[: len(tensor.raw_data) // 8 * 8]).copy()
        if values.size:
            extremes = (np.nan, np.inf, -np.inf, 1e308, -1e308, 0.0, 5e-324)
            values[rng.randrange(values.size)] = rng.choice(extremes)
            tensor.raw_data = values.tobytes()


def _metadata(rng: random.Random, model: ModelProto) -> None:
    for entry in model.metadata_props:
        if entry.key == "cablesense" and rng.random() < 0.5:
            text = mutated_text(rng, entry.value).decode("utf-8", errors="replace")
            entry.value = text.replace("\0", "")
        elif entry.key == "cablesense":
            try:
                content = json.loads(entry.value)
                key = rng.choice(list(content))
            except (ValueError, TypeError, IndexError, RecursionError):  # changed as text
                continue
            content[key] = rng.choice((None, "", -1, 1e308, [], {}, "x" * 5000, True, [1] * 400))
            entry.value = json.dumps(content)


def _edges(rng: random.Random, model: ModelProto) -> None:
    values = [*model.graph.input, *model.graph.output]
    value = rng.choice(values)
    tensor = value.type.tensor_type
    action = rng.randrange(4)
    if action == 0:
        tensor.elem_type = rng.randrange(25)
    elif action == 1 and tensor.shape.dim:
        rng.choice(tensor.shape.dim).dim_value = rng.choice(_INTEGERS)
    elif action == 2:
        value.name = rng.choice(("", "x", rng.choice(values).name))
    else:
        model.opset_import[0].version = rng.choice((0, 1, 7, 13, 99, -1, 2**40))


_CHANGES = (_node, _node, _attribute, _tensor, _tensor, _metadata, _edges)
