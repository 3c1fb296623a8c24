"""A graph that is more than plain operators on its own numbers is refused."""

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
