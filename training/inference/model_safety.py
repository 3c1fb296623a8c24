"""Checks of an ONNX file from outside, before any of it is run.

Plain operators on the numbers in the file and nothing beyond (`require_harmless`), in bounded
memory and work for a sample (`require_bounded`).
"""

from __future__ import annotations

import math

import onnx
from onnx import AttributeProto, ModelProto, NodeProto, TensorProto

from cablesense_training.inference.metadata import ModelFileError

_PLAIN_OPERATORS = """
Abs Add And ArgMax ArgMin Atan Cast Clip Concat Constant ConstantOfShape Conv Cos CumSum Div
Elu Equal Erf Exp Expand Flatten Floor GRU Gather GatherElements Gemm Greater GreaterOrEqual
Identity LSTM LayerNormalization LeakyRelu Less LessOrEqual Log LogSoftmax MatMul Max Min Mul
Neg Not Or Pad Pow Range Reciprocal ReduceL2 ReduceMax ReduceMean ReduceMin ReduceProd
ReduceSum Relu Reshape Shape Sigmoid Sign Sin Slice Softmax Softplus Split Sqrt Squeeze Sub
Tanh Tile Transpose Unsqueeze Where
"""
OPERATORS = {
    "": frozenset(_PLAIN_OPERATORS.split()),
    "com.microsoft": frozenset(("Inverse",)),
}
"""By domain: what networks and the arm's statics are made of. No others run, as there are some
hundred more, and each is native code that a file could feed."""

MAX_ELEMENTS = 2**24
"""Largest tensor of a file; ours stay far below a thousandth of it."""

_PLAIN_ATTRIBUTES = ("FLOAT", "INT", "STRING", "FLOATS", "INTS", "STRINGS", "TENSOR", "TENSORS")

MAX_NODES = 10_000
"""Ours have at most some hundred."""

MAX_ELEMENTS_A_SAMPLE = 2**16
"""Largest tensor that a model may make for one sample; ours stay below 4,000."""

MAX_WORK = 2**26
"""Multiplications for one sample, about a tenth of a second; ours stay below a million."""

_Shapes = dict[str, list[int]]


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
    tensors = list(graph.initializer)
    for node in graph.node:
        domain = "" if node.domain == "ai.onnx" else node.domain
        if node.op_type not in OPERATORS.get(domain, ()):
            shown = f"{node.domain}.{node.op_type}".lstrip(".")[:80]
            raise ModelFileError(
                f"{source}: uses operator {shown!r}; needed are plain arithmetic and "
                "layers of networks, as `cablesense train` writes them"
            )
        for attribute in node.attribute:
            if AttributeProto.AttributeType.Name(attribute.type) not in _PLAIN_ATTRIBUTES:
                raise ModelFileError(
                    f"{source}: operator {node.op_type} holds a graph of its own; "
                    "needed is one plain graph, as `cablesense train` writes it"
                )
            tensors += [attribute.t] if attribute.HasField("t") else []
            tensors += attribute.tensors
    for tensor in tensors:
        if tensor.data_location == TensorProto.EXTERNAL or tensor.external_data:
            raise ModelFileError(
                f"{source}: keeps tensor {tensor.name[:80]!r} in another file; "
                "needed is one file that holds all its numbers"
            )
        if any(dim < 0 for dim in tensor.dims) or math.prod(tensor.dims) > MAX_ELEMENTS:
            raise ModelFileError(
                f"{source}: tensor {tensor.name!r} has shape {list(tensor.dims)}; "
                f"a model's tensors hold at most {MAX_ELEMENTS} numbers each"
            )


def require_bounded(model: ModelProto, source: str) -> None:
    """Refuse a graph whose tensors have no size that is certain beforehand, or that are huge.

    Raises:
        ModelFileError: names the tensor, or the number.
    """
    if len(model.graph.node) > MAX_NODES:
        raise ModelFileError(
            f"{source}: has {len(model.graph.node)} operators; a model has at most {MAX_NODES}"
        )
    shapes = _shapes_of_one_sample(model)
    work = 0
    for node in model.graph.node:
        for name in filter(None, node.output):
            shape = shapes.get(name)
            if shape is None:
                raise ModelFileError(
                    f"{source}: what size tensor {name!r} has is open until the model is run; "
                    "needed is a graph whose sizes depend on the number of samples alone"
                )
            elements = math.prod(shape)
            if elements > MAX_ELEMENTS_A_SAMPLE:
                raise ModelFileError(
                    f"{source}: tensor {name!r} has shape {shape}; a model's tensors hold at "
                    f"most {MAX_ELEMENTS_A_SAMPLE} numbers each a sample"
                )
            work += elements * _terms(node, shapes)
    if work > MAX_WORK:
        raise ModelFileError(
            f"{source}: takes {work:.1e} multiplications a sample; at most {MAX_WORK:.1e} can "
            "be meant"
        )


def _terms(node: NodeProto, shapes: _Shapes) -> int:
    """How many products go into a number that the operator makes, at most."""
    taken = [shapes.get(name, []) for name in node.input]
    if node.op_type in ("MatMul", "Gemm", "Inverse"):
        return max((size for shape in taken for size in shape), default=1)
    if node.op_type == "Conv":
        return math.prod(taken[1][1:])
    if node.op_type in ("GRU", "LSTM"):
        return sum(math.prod(shape[-2:]) for shape in taken[1:3])
    return 1


def _shapes_of_one_sample(model: ModelProto) -> _Shapes:
    """_Shapes of all tensors that onnx can tell, every open dimension of the inputs taken as 1."""
    one = ModelProto()
    one.CopyFrom(model)
    del one.graph.value_info[:]  # claims, which are to be found out
    for entry in one.graph.output:
        entry.type.tensor_type.ClearField("shape")
    for entry in one.graph.input:
        for dim in entry.type.tensor_type.shape.dim:
            if not dim.HasField("dim_value"):
                dim.dim_value = 1
    for node in one.graph.node:
        if node.domain == "com.microsoft":  # onnx does not know Inverse, which keeps the shape
            node.domain, node.op_type = "", "Identity"
    found = onnx.shape_inference.infer_shapes(one, strict_mode=True, data_prop=True).graph
    shapes = {entry.name: list(entry.dims) for entry in one.graph.initializer}
    for value in (*found.input, *found.value_info, *found.output):
        tensor = value.type.tensor_type
        if tensor.HasField("shape") and all(d.HasField("dim_value") for d in tensor.shape.dim):
            shapes[value.name] = [dim.dim_value for dim in tensor.shape.dim]
    return shapes
