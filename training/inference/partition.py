"""A model's graph in two parts: what the command alone decides, and what every sample decides.

Commands change seldom and tensions a thousand times a second. Whatever in the graph depends on the
commanded angles alone is computed when they change and kept.
"""

from __future__ import annotations

import onnx
from onnx import GraphProto, ModelProto, NodeProto, TensorProto, ValueInfoProto, helper


def split_graph(model: ModelProto, changing: str) -> tuple[ModelProto | None, ModelProto]:
    """Split a model into (steady, changing) parts by whether tensors depend on input `changing`.

    The steady part's outputs are inputs of the changing part, by the same names. The steady part
    is None where there is nothing in it to keep.
    """
    graph = model.graph
    moving = {changing}
    for node in graph.node:
        if any(name in moving for name in node.input):
            moving.update(node.output)
    steady_nodes = [n for n in graph.node if not any(name in moving for name in n.output)]
    moving_nodes = [n for n in graph.node if any(name in moving for name in n.output)]
    made = {name for node in steady_nodes for name in node.output}
    wanted = {name for node in moving_nodes for name in node.input}
    wanted |= {output.name for output in graph.output}
    kept = [name for node in steady_nodes for name in node.output if name in wanted & made]
    if not kept:
        return None, model
    types = _tensor_types(model)
    bridge = [helper.make_tensor_value_info(name, types[name], None) for name in kept]
    constant_inputs = [i for i in graph.input if i.name != changing]
    still_wanted = [i for i in constant_inputs if i.name in wanted]
    steady = _part(model, steady_nodes, constant_inputs, bridge)
    moving_inputs = [i for i in graph.input if i.name == changing] + bridge + still_wanted
    return steady, _part(model, moving_nodes, moving_inputs, list(graph.output))


def _tensor_types(model: ModelProto) -> dict[str, int]:
    inferred = onnx.shape_inference.infer_shapes(model).graph
    known = [*inferred.value_info, *inferred.input, *inferred.output]
    types = {value.name: value.type.tensor_type.elem_type for value in known}
    missing = {
        name: TensorProto.DOUBLE
        for node in model.graph.node
        for name in node.output
        if types.get(name, TensorProto.UNDEFINED) == TensorProto.UNDEFINED
    }
    return types | missing


def _part(
    model: ModelProto,
    nodes: list[NodeProto],
    inputs: list[ValueInfoProto],
    outputs: list[ValueInfoProto],
) -> ModelProto:
    used = {name for node in nodes for name in node.input} | {o.name for o in outputs}
    initializers = [value for value in model.graph.initializer if value.name in used]
    graph: GraphProto = helper.make_graph(
        nodes, model.graph.name, inputs, outputs, initializer=initializers
    )
    return helper.make_model(
        graph, opset_imports=model.opset_import, ir_version=model.ir_version
    )
