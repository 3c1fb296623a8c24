"""What an ONNX file may hold: plain operators on its own numbers, and nothing beyond itself."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from onnx import AttributeProto, ModelProto, NodeProto, TensorProto

from cablesense_training.inference.metadata import ModelFileError

OPERATORS: dict[str, frozenset[str]] = {
    "": frozenset(
        (
            "Abs",
            "Add",
            "And",
            "ArgMax",
            "ArgMin",
            "Atan",
            "Cast",
            "Clip",
            "Concat",
            "Constant",
            "ConstantOfShape",
            "Conv",
            "Cos",
            "CumSum",
            "Div",
            "Elu",
            "Equal",
            "Erf",
            "Exp",
            "Expand",
            "Flatten",
            "Floor",
            "GRU",
            "Gather",
            "GatherElements",
            "Gemm",
            "Greater",
            "GreaterOrEqual",
            "Identity",
            "LSTM",
            "LayerNormalization",
            "LeakyRelu",
            "Less",
            "LessOrEqual",
            "Log",
            "LogSoftmax",
            "MatMul",
            "Max",
            "Min",
            "Mul",
            "Neg",
            "Not",
            "Or",
            "Pad",
            "Pow",
            "Range",
            "Reciprocal",
            "ReduceL2",
            "ReduceMax",
            "ReduceMean",
            "ReduceMin",
            "ReduceProd",
            "ReduceSum",
            "Relu",
            "Reshape",
            "Shape",
            "Sigmoid",
            "Sign",
            "Sin",
            "Slice",
            "Softmax",
            "Softplus",
            "Split",
            "Sqrt",
            "Squeeze",
            "Sub",
            "Tanh",
            "Tile",
            "Transpose",
            "Unsqueeze",
            "Where",
        )
    ),
    "com.microsoft": frozenset(("Inverse",)),
}
"""By domain: what networks and the arm's statics are made of. No others run, as there are some
hundred more, and each is native code that a file could feed."""

MAX_ELEMENTS = 2**24
"""Largest tensor of a file; ours stay far below a thousandth of it."""

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
        ModelFileError: external data, nested graphs, functions, other operators, huge tensors.
    """
    graph = model.graph
    if model.functions or model.training_info or graph.sparse_initializer:
        raise ModelFileError(
            f"{source}: has functions, sparse tensors or training steps of its own; "
            "needed is one plain graph, as `cablesense train` writes it"
        )
    for node in graph.node:
        domain = "" if node.domain == "ai.onnx" else node.domain
        if node.op_type not in OPERATORS.get(domain, ()):
            raise ModelFileError(
                f"{source}: uses operator {_shown(node)}; needed are plain arithmetic and "
                "layers of networks, as `cablesense train` writes them"
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
                f"{source}: keeps tensor {tensor.name[:80]!r} in another file; "
                "needed is one file that holds all its numbers"
            )
        _require_size(tensor.name, tensor.dims, source)


def _shown(node: NodeProto) -> str:
    return repr(f"{node.domain}.{node.op_type}".lstrip(".")[:80])


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
