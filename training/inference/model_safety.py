"""What an ONNX file may not do here: reach beyond itself, or ask for memory without measure."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from onnx import AttributeProto, ModelProto, TensorProto

from cablesense_training.inference.metadata import ModelFileError

DOMAINS = ("", "ai.onnx", "com.microsoft")
"""Operator sets that ONNX Runtime brings along."""

MAX_ELEMENTS = 2**24
"""Largest tensor that a model may make for one sample; ours stay far below a thousandth of it."""

_TENSOR_ATTRIBUTES = (AttributeProto.TENSOR, AttributeProto.TENSORS)
_PLAIN_ATTRIBUTES = (
    AttributeProto.FLOAT,
    AttributeProto.INT,
    AttributeProto.STRING,
    AttributeProto.FLOATS,
    AttributeProto.INTS,
    AttributeProto.STRINGS,
)


def require_harmless(model: ModelProto, source: str) -> None:
    """Refuse a graph that is more than operators on the numbers in this very file.

    Raises:
        ModelFileError: external data, nested graphs, functions, foreign operators, huge tensors.
    """
    graph = model.graph
    if model.functions or model.training_info or graph.sparse_initializer:
        raise ModelFileError(
            f"{source}: has functions, sparse tensors or training steps of its own; "
            "needed is one plain graph, as `cablesense train` writes it"
        )
    for node in graph.node:
        if node.domain not in DOMAINS:
            raise ModelFileError(
                f"{source}: uses operator {node.domain}.{node.op_type}; "
                "needed are those of ONNX and ONNX Runtime alone"
            )
        for attribute in node.attribute:
            if attribute.type not in (*_PLAIN_ATTRIBUTES, *_TENSOR_ATTRIBUTES):
                raise ModelFileError(
                    f"{source}: operator {node.op_type} holds a graph of its own; "
                    "needed is one plain graph, as `cablesense train` writes it"
                )
    for tensor in _tensors(model):
        if tensor.data_location == TensorProto.EXTERNAL or tensor.external_data:
            raise ModelFileError(
                f"{source}: keeps tensor {tensor.name!r} in another file; "
                "needed is one file that holds all its numbers"
            )
        _require_size(tensor.name, tensor.dims, source)


def require_bounded(inferred: ModelProto, source: str) -> None:
    """Refuse a graph, its shapes inferred, that makes huge tensors.

    Raises:
        ModelFileError: names the tensor.
    """
    for value in (*inferred.graph.value_info, *inferred.graph.output):
        dims = [dim.dim_value for dim in value.type.tensor_type.shape.dim if dim.dim_value]
        _require_size(value.name, dims, source)


def _tensors(model: ModelProto) -> Iterator[TensorProto]:
    yield from model.graph.initializer
    for node in model.graph.node:
        for attribute in node.attribute:
            if attribute.type == AttributeProto.TENSOR:
                yield attribute.t
            yield from attribute.tensors


def _require_size(name: str, dims: Sequence[int], source: str) -> None:
    if any(dim < 0 for dim in dims) or math.prod(dims) > MAX_ELEMENTS:
        raise ModelFileError(
            f"{source}: tensor {name!r} has shape {list(dims)}; "
            f"a model's tensors hold at most {MAX_ELEMENTS} numbers each"
        )
