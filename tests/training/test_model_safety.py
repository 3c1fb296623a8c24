"""A graph that is more than plain operators on its own numbers is refused.

A graph that asks for more memory or work than a sample is worth is refused before it runs.
"""

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper
from small_models import DOUBLE, refused, small_model, value, written


def test_numbers_kept_in_another_file_are_refused(tmp_path):
    secret = tmp_path / "secret"
    secret.write_bytes(bytes(12 * 2 * 8))
    for location in ("secret", str(secret), "../secret", "/etc/hostname"):
        model = small_model()
        [turn] = [tensor for tensor in model.graph.initializer if tensor.name == "turn"]
        turn.raw_data = np.zeros((12, 2)).tobytes()
        turn.ClearField("double_data")
        onnx.external_data_helper.set_external_data(turn, location)
        turn.ClearField("raw_data")
        assert "another file" in refused(written(tmp_path, model))
        constant = onnx.TensorProto()
        constant.CopyFrom(turn)
        node = helper.make_node("Constant", [], ["direction"], value=constant)
        assert "another file" in refused(written(tmp_path, small_model(nodes=[node])))


def test_nested_graphs_and_functions_are_refused(tmp_path):
    body = helper.make_graph(
        [helper.make_node("Identity", ["classes"], ["x"])], "body", [], [value("x", DOUBLE, None)]
    )
    truth = helper.make_tensor("truth", TensorProto.BOOL, [], [True])
    node = helper.make_node("If", ["truth"], ["direction"], then_branch=body, else_branch=body)
    model = small_model(nodes=[node], initializers=[truth])
    assert "uses operator 'If'" in refused(written(tmp_path, model))
    node.op_type = "Identity"
    model = small_model(nodes=[node], initializers=[truth])
    assert "graph of its own" in refused(written(tmp_path, model))
    model = small_model()
    model.functions.append(
        helper.make_function(
            "own", "F", ["x"], ["y"], [helper.make_node("Tanh", ["x"], ["y"])], model.opset_import
        )
    )
    assert "functions" in refused(written(tmp_path, model))


@pytest.mark.parametrize("dims", [[2**40], [2**31, 2**31, 2**31], [-1, 4], [0, 2**62]])
def test_a_tensor_that_only_claims_its_size_is_refused(tmp_path, dims):
    model = small_model()
    model.graph.initializer[1].ClearField("dims")
    model.graph.initializer[1].dims.extend(dims)
    refused(written(tmp_path, model))


@pytest.mark.parametrize(
    ("domain", "operator"),
    [("", "Loop"), ("", "NonZero"), ("com.microsoft", "Attention"), ("own", "Add"), ("", "")],
)
def test_operators_that_no_network_here_needs_are_refused(tmp_path, domain, operator):
    node = helper.make_node(operator, ["tension_difference_n"], ["direction"], domain=domain)
    assert "uses operator" in refused(written(tmp_path, small_model(nodes=[node])))


@pytest.mark.parametrize("size", [2**28, 2**45, 2**62])
def test_a_graph_that_makes_huge_tensors_is_refused(tmp_path, size):
    shape = helper.make_tensor("shape", TensorProto.INT64, [1], [size])
    nodes = [
        helper.make_node("ConstantOfShape", ["shape"], ["huge"]),
        helper.make_node("ReduceSum", ["huge"], ["sum"], keepdims=0),
        helper.make_node("Cast", ["sum"], ["none"], to=DOUBLE),
        helper.make_node("MatMul", ["tension_difference_n", "turn"], ["turned"]),
        helper.make_node("Add", ["turned", "none"], ["direction"]),
    ]
    model = small_model(nodes=nodes, initializers=[shape])
    assert "'huge'" in refused(written(tmp_path, model))


def test_a_size_that_depends_on_the_tensions_is_refused(tmp_path):
    nodes = [
        helper.make_node("ReduceSum", ["tension_difference_n"], ["sum"], keepdims=0),
        helper.make_node("Cast", ["sum"], ["shape"], to=TensorProto.INT64),
        helper.make_node("Reshape", ["shape", "one"], ["row"]),
        helper.make_node("Expand", ["last_of", "row"], ["wide"]),
        helper.make_node("ReduceSum", ["wide"], ["direction"], keepdims=0),
    ]
    one = helper.make_tensor("one", TensorProto.INT64, [1], [1])
    model = small_model(
        nodes=nodes, initializers=[one, helper.make_tensor("last_of", DOUBLE, [1], [1.0])]
    )
    assert "is open until the model is run" in refused(written(tmp_path, model))


def test_more_work_than_a_sample_is_worth_is_refused(tmp_path):
    names = [f"step_{i}" for i in range(600)]
    large = helper.make_tensor("large", DOUBLE, [256, 256], [0.0] * 2**16)
    nodes = [
        helper.make_node("MatMul", [left, "large"], [right])
        for left, right in zip(["large", *names], names, strict=False)
    ]
    assert "multiplications a sample" in refused(
        written(tmp_path, small_model(nodes=nodes, initializers=[large]))
    )
