"""The parts of a split graph say together what the whole says."""

import numpy as np
import onnx
import onnxruntime
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from onnx import TensorProto, helper

from cablesense_training.inference.metadata import find_model
from cablesense_training.inference.session import COMMAND, TAUT, TENSION
from cablesense_training.inference.single_run import split_graph

pytestmark = pytest.mark.slow


CHANGING, STEADY = TENSION, COMMAND


def _model(nodes, outputs, inputs=(CHANGING, STEADY)):
    def values(names):
        return [helper.make_tensor_value_info(n, TensorProto.DOUBLE, [None, 3]) for n in names]

    one = helper.make_tensor("one", TensorProto.DOUBLE, [1, 3], [1.0, 2.0, 3.0])
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


def _inputs_of(part):
    return {entry.name for entry in part.graph.input}


def _require_agreement(model, inputs, held=None):
    """Every part runs on what the parts before it gave; `held` is the whole's own value of it."""
    whole = _run(model, inputs)
    parts = split_graph(model, CHANGING, held)
    known = {STEADY: inputs[STEADY]}
    if parts.steady is not None:
        assert _inputs_of(parts.steady) <= {STEADY}
        known |= _run(parts.steady, known)
    if parts.held is not None:
        assert held in _inputs_of(parts.held)
        known |= _run(parts.held, known | {held: whole[held]})
    assert CHANGING not in known
    assert held not in _inputs_of(parts.moving)
    found = _run(parts.moving, known | {CHANGING: inputs[CHANGING]})
    assert list(found) == list(whole)
    for name, value in whole.items():
        np.testing.assert_allclose(found[name], value, rtol=1e-12, atol=1e-12)
    return parts


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


def _drawn(seed):
    rng = np.random.default_rng(seed)
    return {CHANGING: rng.normal(size=(2, 3)), STEADY: rng.normal(size=(2, 3))}


@settings(max_examples=30, deadline=None)
@given(graphs(), st.integers(0, 2**32 - 1))
def test_parts_agree_with_the_whole_for_any_graph(model, seed):
    assert _require_agreement(model, _drawn(seed)).held is None


@settings(max_examples=30, deadline=None)
@given(graphs(), st.integers(0, 2**32 - 1))
def test_parts_agree_with_the_whole_whatever_is_held(model, seed):
    inputs = _drawn(seed)
    held = model.graph.output[0].name
    whole, other = _run(model, inputs), _run(model, inputs | {CHANGING: 1.0 + inputs[CHANGING]})
    assume((whole[held] != other[held]).any())
    _require_agreement(model, inputs, held)


def test_what_the_command_alone_decides_is_in_the_steady_part():
    nodes = [
        helper.make_node("Cos", [STEADY], ["cosine"]),
        helper.make_node("Mul", ["cosine", "one"], ["scaled"]),
        helper.make_node("Add", ["scaled", CHANGING], ["sum"]),
        helper.make_node("Mul", ["sum", STEADY], ["product"]),
    ]
    parts = _require_agreement(_model(nodes, ["product"]), _drawn(0))
    assert [node.op_type for node in parts.steady.graph.node] == ["Cos", "Mul"]
    assert [node.op_type for node in parts.moving.graph.node] == ["Add", "Mul"]
    assert [entry.name for entry in parts.steady.graph.output] == ["scaled"]


def test_what_the_held_tensor_and_the_command_decide_is_in_the_held_part():
    nodes = [
        helper.make_node("Cos", [STEADY], ["cosine"]),
        helper.make_node("Sign", [CHANGING], ["sign"]),
        helper.make_node("Tanh", ["sign"], ["bent"]),
        helper.make_node("Mul", ["bent", "cosine"], ["scaled"]),
        helper.make_node("Add", ["scaled", CHANGING], ["sum"]),
        helper.make_node("Sub", ["sum", "sign"], ["rest"]),
    ]
    parts = _require_agreement(_model(nodes, ["rest", "sign"]), _drawn(0), held="sign")
    assert [node.op_type for node in parts.steady.graph.node] == ["Cos"]
    assert [node.op_type for node in parts.held.graph.node] == ["Tanh", "Mul"]
    assert [node.op_type for node in parts.moving.graph.node] == ["Sign", "Add", "Sub"]
    assert [entry.name for entry in parts.held.graph.output] == ["scaled"]


def test_a_graph_of_the_changing_input_alone_is_not_split():
    model = _model([helper.make_node("Tanh", [CHANGING], ["out"])], ["out"], inputs=(CHANGING,))
    parts = split_graph(model, CHANGING)
    assert parts.steady is None
    assert parts.held is None
    assert parts.moving is model


@pytest.fixture
def samples():
    rng = np.random.default_rng(1)
    return {CHANGING: rng.normal(0.0, 30.0, (50, 12)), STEADY: rng.uniform(-0.3, 0.3, (50, 8))}


def test_parts_of_a_model_file_agree_with_the_whole(samples):
    model = onnx.load(find_model("cdsm"))
    without = _require_agreement(model, samples)
    parts = _require_agreement(model, samples, held=TAUT)
    assert without.held is None
    assert len(parts.moving.graph.node) < len(without.moving.graph.node) / 2


def test_a_model_of_tensions_alone_is_one_part(samples):
    parts = _require_agreement(onnx.load(find_model("cdsm_tensions_only")), samples)
    assert parts.steady is None
