"""Model files from outside: read, and checked before any of a graph is run."""

from __future__ import annotations

import math
from pathlib import Path

import onnx
from onnx import AttributeProto, ModelProto, TensorProto

from cablesense_base.files import read_bounded_bytes
from cablesense_contact.errors import ModelFileError
from cablesense_contact.inference.metadata import ModelMetadata

MAX_FILE_BYTES = 64 * 1024 * 1024
"""Models are a fraction of a megabyte; a file beyond this is not one."""

_PLAIN_OPERATORS = """
Abs Add And ArgMax ArgMin Atan Cast Clip Concat Constant ConstantOfShape Cos CumSum Div Elu
Equal Erf Exp Expand EyeLike Flatten Floor Gather GatherElements Gemm Greater GreaterOrEqual
Identity LayerNormalization LeakyRelu Less LessOrEqual Log LogSoftmax MatMul Max Min Mul Neg
Not Or Pad Pow Range Reciprocal ReduceL2 ReduceLogSumExp ReduceMax ReduceMean ReduceMin
ReduceProd ReduceSum Relu Reshape Shape Sigmoid Sign Sin Slice Softmax Softplus Split Sqrt
Squeeze Sub Tanh Tile Transpose Unsqueeze Where
"""
OPERATORS = {
    "": frozenset(_PLAIN_OPERATORS.split()),
    "ai.onnx": frozenset(_PLAIN_OPERATORS.split()),
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


def read_model(path: str | Path) -> tuple[ModelProto, ModelMetadata]:
    """The graph in a model file, and what the file states about itself; nothing is run.

    Raises:
        ModelFileError: unreadable, not ONNX, or not a CableSense model.
    """
    model, properties = read_graph(path)
    return model, ModelMetadata.from_properties(properties, str(path))


def read_graph(path: str | Path) -> tuple[ModelProto, dict[str, str]]:
    """The graph in an ONNX file, and its metadata properties; nothing is run.

    Raises:
        ModelFileError: unreadable, not ONNX, or more than plain operators.
    """
    content = read_bounded_bytes(path, MAX_FILE_BYTES, "a model file (.onnx)", ModelFileError)
    try:
        model = onnx.load_model_from_string(content)
        require_harmless(model, str(path))
        onnx.checker.check_model(model)
    except ModelFileError:
        raise
    except Exception as error:  # protobuf and onnx raise whatever the broken place led to
        raise ModelFileError(
            f"{path}: not a valid ONNX file ({one_line(error)}); needed is a model file, "
            "as `cablesense export` and `cablesense train` write it"
        ) from error
    return model, {entry.key: entry.value for entry in model.metadata_props}


def one_line(error: Exception) -> str:
    """The beginning of an error's text, without line breaks."""
    return " ".join(str(error).split())[:200]


def require_harmless(model: ModelProto, source: str) -> None:
    """Refuse a graph that is more than plain operators on the numbers in this very file."""
    graph = model.graph
    problem = ""
    if model.functions or model.training_info or graph.sparse_initializer:
        problem = "has functions, sparse tensors or training steps"
    tensors = list(graph.initializer)
    for node in graph.node:
        if node.op_type not in OPERATORS.get(node.domain, ()):
            operator = f"{node.domain}.{node.op_type}".lstrip(".")[:80]
            problem = f"uses operator {operator!r}, which is no arithmetic or layer of a network"
        for attribute in node.attribute:
            if AttributeProto.AttributeType.Name(attribute.type) not in _PLAIN_ATTRIBUTES:
                problem = problem or f"operator {node.op_type} holds a graph inside"
            tensors += [attribute.t] if attribute.HasField("t") else []
            tensors += attribute.tensors
    for tensor in tensors:
        if tensor.data_location == TensorProto.EXTERNAL or tensor.external_data:
            problem = f"keeps tensor {tensor.name[:80]!r} in another file"
        if any(dim < 0 for dim in tensor.dims) or math.prod(tensor.dims) > MAX_ELEMENTS:
            problem = (
                f"tensor {tensor.name[:80]!r} has shape {list(tensor.dims)[:9]}, more than "
                f"{MAX_ELEMENTS} numbers"
            )
    if problem:
        raise ModelFileError(
            f"{source}: {problem}; needed is one plain graph with all its numbers in this file, "
            "as `cablesense export` and `cablesense train` write it"
        )


def require_bounded(model: ModelProto, source: str) -> None:
    """Refuse a graph whose memory or work for a sample is huge, or not certain beforehand."""
    if len(model.graph.node) > MAX_NODES:
        raise ModelFileError(
            f"{source}: has {len(model.graph.node)} operators; a model has at most {MAX_NODES}"
        )
    shapes = _shapes_of_one_sample(model)
    work = 0
    for node in model.graph.node:
        for name in filter(None, node.output):
            if name not in shapes:
                raise ModelFileError(
                    f"{source}: what size tensor {name!r} has is open until the model is run; "
                    "needed is a graph whose sizes depend on the number of samples alone"
                )
            elements = math.prod(shapes[name])
            if elements > MAX_ELEMENTS_A_SAMPLE:
                raise ModelFileError(
                    f"{source}: tensor {name!r} has shape {shapes[name]}; a model's tensors hold "
                    f"at most {MAX_ELEMENTS_A_SAMPLE} numbers each a sample"
                )
            summed = node.op_type in ("MatMul", "Gemm", "Inverse")
            taken = (size for operand in node.input for size in shapes.get(operand, ()))
            work += elements * (max(taken, default=1) if summed else 1)
    if work > MAX_WORK:
        raise ModelFileError(
            f"{source}: takes {work:.1e} multiplications a sample; at most {MAX_WORK:.1e} can "
            "be meant"
        )


def _shapes_of_one_sample(model: ModelProto) -> _Shapes:
    """Shapes of all tensors that onnx can tell, every open dimension of the inputs taken as 1."""
    single = ModelProto()
    single.CopyFrom(model)
    del single.graph.value_info[:]  # claims, which are to be found out
    for entry in single.graph.output:
        entry.type.tensor_type.ClearField("shape")
    for entry in single.graph.input:
        for dim in entry.type.tensor_type.shape.dim:
            if not dim.HasField("dim_value"):
                dim.dim_value = 1
    for node in single.graph.node:
        if node.domain == "com.microsoft":  # onnx does not know Inverse, which keeps the shape
            node.domain = ""
            node.op_type = "Identity"
    inferred = onnx.shape_inference.infer_shapes(single, strict_mode=True, data_prop=True).graph
    shapes = {entry.name: list(entry.dims) for entry in single.graph.initializer}
    for value in (*inferred.input, *inferred.value_info, *inferred.output):
        tensor = value.type.tensor_type
        if tensor.HasField("shape") and all(d.HasField("dim_value") for d in tensor.shape.dim):
            shapes[value.name] = [dim.dim_value for dim in tensor.shape.dim]
    return shapes
