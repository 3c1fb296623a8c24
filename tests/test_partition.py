"""The two parts of a split graph say together what the whole says."""

import numpy as np
import onnx
import onnxruntime
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from onnx import TensorProto, helper

from cablesense_training.inference.partition import split_graph

CHANGING, STEADY = "tension_difference_n", "joint_command_rad"


def _model(nodes, outputs, inputs=(CHANGING, STEADY)):
    def values(names):
        return [helper.make_tensor_value_info(n, TensorProto.DOUBLE, [None, 3]) for n in names]

    one = helper.make_tensor("one", TensorProto.DOUBLE, [3], [1.0, 2.0, 3.0])
    graph = helper.make_graph(nodes, "test", values(inputs), values(outputs), initializer=[one])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
    onnx.checker.check_model(model)
    return model


def _run(model, inputs):
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(
        model.SerializeToString(), options, providers=["CPUExecutionProvider"]
    )
    wanted = {entry.name for entry in session.get_inputs()}
    names = [entry.name for entry in session.get_outputs()]
    values = session.run(names, {k: v for k, v in inputs.items() if k in wanted})
    return dict(zip(names, values, strict=True))


def _require_agreement(model, inputs):
    whole = _run(model, inputs)
    steady, changing = split_graph(model, CHANGING)
    assert CHANGING in {entry.name for entry in changing.graph.input}
    known = dict(inputs)
    if steady is not None:
        assert CHANGING not in {entry.name for entry in steady.graph.input}
        known |= _run(steady, {STEADY: inputs[STEADY]})
        assert STEADY in known
    parts = _run(changing, known)
    assert list(parts) == list(whole)
    for name, value in whole.items():
        np.testing.assert_allclose(parts[name], value, rtol=1e-12, atol=1e-12)
    return steady, changing


@st.composite
def graphs(draw):
    """Operators that each take what came before, and any of the tensors as outputs."""
    names, nodes = [CHANGING, STEADY, "one"], []
    for number in range(draw(st.integers(1, 12))):
        kind = draw(st.sampled_from(["Add", "Mul", "Sub", "Tanh", "Neg", "Split"]))
        arity = 2 if kind in ("Add", "Mul", "Sub") else 1
        taken = [draw(st.sampled_from(names)) for _ in range(arity)]
        if kind == "Split":
            parts = [f"a{number}", f"b{number}"]
            nodes.append(helper.make_node("Split", taken, parts, axis=-1, num_outputs=2))
            nodes.append(helper.make_node("Concat", parts[::-1], [f"t{number}"], axis=-1))
        else:
            nodes.append(helper.make_node(kind, taken, [f"t{number}"]))
        names.append(f"t{number}")
    made = [name for name in names if name.startswith("t") and name != CHANGING]
    outputs = draw(st.lists(st.sampled_from(made), min_size=1, max_size=3, unique=True))
    return _model(nodes, outputs)


@settings(max_examples=60, deadline=None)
@given(graphs(), st.integers(0, 2**32 - 1))
def test_parts_agree_with_the_whole_for_any_graph(model, seed):
    rng = np.random.default_rng(seed)
    inputs = {CHANGING: rng.normal(size=(2, 3)), STEADY: rng.normal(size=(2, 3))}
    _require_agreement(model, inputs)


def test_what_the_command_alone_decides_is_in_the_steady_part():
    nodes = [
        helper.make_node("Cos", [STEADY], ["cosine"]),
        helper.make_node("Mul", ["cosine", "one"], ["scaled"]),
        helper.make_node("Add", ["scaled", CHANGING], ["sum"]),
        helper.make_node("Mul", ["sum", STEADY], ["product"]),
    ]
    rng = np.random.default_rng(0)
    inputs = {CHANGING: rng.normal(size=(1, 3)), STEADY: rng.normal(size=(1, 3))}
    steady, changing = _require_agreement(_model(nodes, ["product"]), inputs)
    assert [node.op_type for node in steady.graph.node] == ["Cos", "Mul"]
    assert [node.op_type for node in changing.graph.node] == ["Add", "Mul"]
    assert [entry.name for entry in steady.graph.output] == ["scaled"]


def test_a_graph_of_the_changing_input_alone_is_not_split():
    model = _model([helper.make_node("Tanh", [CHANGING], ["out"])], ["out"], inputs=(CHANGING,))
    steady, changing = split_graph(model, CHANGING)
    assert steady is None
    assert changing is model


@pytest.mark.parametrize("network", ["closed-form-corrected", "two-stage"])
def test_parts_of_a_model_file_agree_with_the_whole(model_files, network):
    model = onnx.load(model_files(network))
    rng = np.random.default_rng(1)
    inputs = {CHANGING: rng.normal(0.0, 30.0, (50, 12)), STEADY: rng.uniform(-0.3, 0.3, (50, 8))}
    steady, _ = _require_agreement(model, inputs)
    assert (steady is None) == (network == "two-stage")
