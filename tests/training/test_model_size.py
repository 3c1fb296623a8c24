"""A graph that asks for more memory or work than a sample is worth is refused before it runs."""

import pytest
from onnx import TensorProto, helper
from small_models import DOUBLE, refused, small_model, written


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
