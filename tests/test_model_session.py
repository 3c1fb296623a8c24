"""A file that is no fitting model is refused in one line; whatever opens, answers."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import onnx
import pytest
from arm_variants import variant
from hypothesis import given, settings
from hypothesis import strategies as st
from model_fixtures import metadata_for
from onnx import TensorProto, helper

from cablesense_msgs_py.errors import CableSenseError
from cablesense_sim.arm_files import open_arm
from cablesense_training.inference.estimator import OUTPUTS, Estimator
from cablesense_training.inference.metadata import ModelFileError
from cablesense_training.inference.model_files import find_model
from cablesense_training.inference.multi_estimator import OUTPUTS as MULTI_OUTPUTS
from cablesense_training.inference.session import (
    MAX_FILE_BYTES,
    TAUT,
    ModelSession,
    open_session,
)

CDSM = open_arm("cdsm")
FLOAT, DOUBLE = TensorProto.FLOAT, TensorProto.DOUBLE
RANKS = dict(zip(OUTPUTS, (2, 2, 1, 1, 1), strict=True))


def _value(name, kind, shape):
    return helper.make_tensor_value_info(name, kind, shape)


def _weights(name, rows, columns, kind=DOUBLE):
    numbers = np.linspace(-1.0, 1.0, rows * columns)
    return helper.make_tensor(name, kind, [rows, columns], numbers.tolist())


def _small_model(kind=DOUBLE, nodes=(), initializers=(), inputs=None, properties=None):
    """A tensions-only model of few operators; `nodes` replace those that write the same."""
    own = [
        helper.make_node("MatMul", ["tension_difference_n", "classes"], ["logits"]),
        helper.make_node("Softmax", ["logits"], ["contact_probability"], axis=-1),
        helper.make_node("MatMul", ["tension_difference_n", "turn"], ["direction"]),
        helper.make_node(
            "ReduceL2", ["tension_difference_n", "last"], ["magnitude_n"], keepdims=0
        ),
        helper.make_node("Exp", ["magnitude_n"], ["magnitude_std_n"]),
        helper.make_node("Sqrt", ["magnitude_n"], ["angle_std_deg"]),
    ]
    written = {name for node in nodes for name in node.output}
    graph = helper.make_graph(
        [*(node for node in own if not written & set(node.output)), *nodes],
        "small",
        inputs or [_value("tension_difference_n", kind, ["batch", 12])],
        [_value(name, kind, ["batch", f"{name}s"][:rank]) for name, rank in RANKS.items()],
        initializer=[
            _weights("classes", 12, 5, kind),
            _weights("turn", 12, 2, kind),
            helper.make_tensor("last", TensorProto.INT64, [1], [-1]),
            *initializers,
        ],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
    if properties is None:
        properties = metadata_for(CDSM, pose_aware=False, network="small").to_properties()
    helper.set_model_props(model, properties)
    return model


def _written(tmp_path, model):
    path = tmp_path / "model.onnx"
    path.write_bytes(model if isinstance(model, bytes) else model.SerializeToString())
    return path


def _refused(path, outputs=OUTPUTS, arm=None):
    with pytest.raises(ModelFileError) as caught:
        ModelSession.open(path, outputs, arm)
    message = str(caught.value)
    assert str(path) in message
    assert "\n" not in message
    return message


def test_a_small_model_opens(tmp_path):
    session = ModelSession.open(_written(tmp_path, _small_model()), OUTPUTS, CDSM)
    answers = session.run(np.ones((3, 12)), np.zeros((3, 8)))
    assert [answer.shape for answer in answers] == [(3, 5), (3, 2), (3,), (3,), (3,)]
    assert not session.tells_taut


def test_a_model_may_tell_beside_its_answers_which_cables_are_taut(tmp_path):
    model = _small_model(nodes=[helper.make_node("Sign", ["tension_difference_n"], [TAUT])])
    taut = _value(TAUT, DOUBLE, ["batch", 12])
    model.graph.output.append(taut)
    session = ModelSession.open(_written(tmp_path, model), OUTPUTS, CDSM)
    assert session.tells_taut
    assert len(session.run(np.ones((3, 12)), None)) == len(OUTPUTS)
    model.graph.output.append(taut)
    assert TAUT in _refused(_written(tmp_path, model))


def test_a_model_that_tells_something_else_is_refused(tmp_path):
    model = _small_model(nodes=[helper.make_node("Sign", ["tension_difference_n"], ["sign"])])
    model.graph.output.append(_value("sign", DOUBLE, ["batch", 12]))
    assert "sign" in _refused(_written(tmp_path, model))


@pytest.mark.parametrize(("kind", "width"), [(FLOAT, 12), (DOUBLE, 7)])
def test_taut_cables_told_in_another_type_or_number_are_refused(tmp_path, kind, width):
    model = _small_model()
    model.graph.initializer.append(_weights("pull", 12, width))
    model.graph.node.append(helper.make_node("MatMul", ["tension_difference_n", "pull"], ["told"]))
    model.graph.node.append(helper.make_node("Cast", ["told"], [TAUT], to=kind))
    model.graph.output.append(_value(TAUT, kind, ["batch", width]))
    assert TAUT in _refused(_written(tmp_path, model))


def test_one_thread_runs_it(tmp_path):
    tasks = Path("/proc/self/task")
    before = {task.name for task in tasks.iterdir()}
    session = ModelSession.open(_written(tmp_path, _small_model()), OUTPUTS)
    session.run(np.ones((1, 12)), None)
    assert {task.name for task in tasks.iterdir()} <= before
    assert open_session(session.model).get_session_options().intra_op_num_threads == 1


def test_no_file_is_said_to_be_none(tmp_path):
    assert "No such file" in _refused(tmp_path / "none.onnx")
    assert "not a file" in _refused(tmp_path)


@pytest.mark.parametrize("content", [b"", b"\x00", b"not a model", os.urandom(5000)])
def test_other_content_is_refused(tmp_path, content):
    _refused(_written(tmp_path, content))


def test_a_truncated_file_is_refused(tmp_path):
    whole = _small_model().SerializeToString()
    for length in range(1, len(whole), 97):
        _refused(_written(tmp_path, whole[:length]))


def test_a_huge_file_is_refused_unread(tmp_path):
    path = tmp_path / "huge.onnx"
    with path.open("wb") as file:
        file.truncate(MAX_FILE_BYTES + 1)
    assert "larger" in _refused(path)


def test_another_onnx_file_is_refused(tmp_path):
    message = _refused(_written(tmp_path, _small_model(properties={"made by": "somebody"})))
    assert "not a CableSense model" in message


def test_a_model_of_another_arm_names_both(tmp_path):
    lab = open_arm("cdsm_lab")
    message = _refused(_written(tmp_path, _small_model()), arm=lab)
    assert CDSM.identity in message
    assert lab.identity in message


def test_a_model_of_the_arm_without_its_effects_fits_one_with_them(tmp_path):
    gain = {"effect": "sensor_gain", "at": "cable_1", "parameters": {"gain": 0.1}}
    path, odd = _written(tmp_path, _small_model()), variant({"effects": [gain]})
    assert odd.identity != CDSM.identity
    assert ModelSession.open(path, OUTPUTS, odd).metadata.arm_identity == CDSM.identity
    assert CDSM.identity in _refused(path, arm=variant({"effects": [gain]}, "cdsm_lab"))


def test_other_outputs_than_needed_are_listed(tmp_path):
    message = _refused(_written(tmp_path, _small_model()), outputs=MULTI_OUTPUTS)
    assert "direction" in message
    assert "contact_probability, magnitude_n, magnitude_std_n" in message


def test_single_precision_is_refused(tmp_path):
    assert "FLOAT" in _refused(_written(tmp_path, _small_model(kind=FLOAT)))


@pytest.mark.parametrize(
    "inputs",
    [
        [_value("tension_difference_n", DOUBLE, ["batch", 9])],
        [_value("tension_difference_n", DOUBLE, [1, 12])],
        [_value("tension_difference_n", DOUBLE, [12])],
        [_value("tension_difference_n", DOUBLE, ["a", "b", 12])],
        [_value("tension_difference_n", DOUBLE, None)],
        [
            _value("tension_difference_n", DOUBLE, ["batch", 12]),
            _value("joint_command_rad", DOUBLE, ["batch", 8]),
        ],
        [
            _value("tension_difference_n", DOUBLE, ["batch", 12]),
            _value("temperature", DOUBLE, ["batch", 1]),
        ],
    ],
    ids=["nine cables", "one sample", "vector", "cube", "any shape", "command too", "temperature"],
)
def test_other_inputs_than_the_metadata_say_are_refused(tmp_path, inputs):
    message = _refused(_written(tmp_path, _small_model(inputs=inputs)))
    assert "tension_difference_n (batch, 12)" in message or "not a valid" in message


@pytest.mark.parametrize(
    "nodes",
    [
        [helper.make_node("Identity", ["tension_difference_n"], ["direction"])],
        [helper.make_node("Identity", ["tension_difference_n"], ["magnitude_n"])],
        [helper.make_node("Cast", ["logits"], ["contact_probability"], to=FLOAT)],
        [helper.make_node("Log", ["magnitude_n"], ["angle_std_deg"])],
        [helper.make_node("MatMul", ["classes", "turn"], ["direction"])],
        [helper.make_node("Div", ["direction", "direction"], ["direction"])],
        [helper.make_node("Tanh", ["angle_std_deg"], ["logits"])],
        [helper.make_node("Transmogrify", ["tension_difference_n"], ["direction"])],
        [helper.make_node("Evil", ["tension_difference_n"], ["direction"], domain="elsewhere")],
    ],
    ids=[
        "too wide",
        "too many",
        "single precision",
        "not finite",
        "cannot multiply",
        "from itself",
        "cycle",
        "no such operator",
        "foreign operator",
    ],
)
def test_a_graph_that_cannot_answer_is_refused(tmp_path, nodes):
    _refused(_written(tmp_path, _small_model(nodes=nodes)))


def test_numbers_kept_in_another_file_are_refused(tmp_path):
    secret = tmp_path / "secret"
    secret.write_bytes(bytes(12 * 2 * 8))
    for location in ("secret", str(secret), "../secret", "/etc/hostname"):
        model = _small_model()
        [turn] = [tensor for tensor in model.graph.initializer if tensor.name == "turn"]
        turn.raw_data = np.zeros((12, 2)).tobytes()
        turn.ClearField("double_data")
        onnx.external_data_helper.set_external_data(turn, location)
        turn.ClearField("raw_data")
        assert "another file" in _refused(_written(tmp_path, model))
        constant = onnx.TensorProto()
        constant.CopyFrom(turn)
        node = helper.make_node("Constant", [], ["direction"], value=constant)
        assert "another file" in _refused(_written(tmp_path, _small_model(nodes=[node])))


def test_nested_graphs_and_functions_are_refused(tmp_path):
    body = helper.make_graph(
        [helper.make_node("Identity", ["classes"], ["x"])], "body", [], [_value("x", DOUBLE, None)]
    )
    truth = helper.make_tensor("truth", TensorProto.BOOL, [], [True])
    node = helper.make_node("If", ["truth"], ["direction"], then_branch=body, else_branch=body)
    model = _small_model(nodes=[node], initializers=[truth])
    assert "uses operator 'If'" in _refused(_written(tmp_path, model))
    node.op_type = "Identity"
    model = _small_model(nodes=[node], initializers=[truth])
    assert "graph of its own" in _refused(_written(tmp_path, model))
    model = _small_model()
    model.functions.append(
        helper.make_function(
            "own", "F", ["x"], ["y"], [helper.make_node("Tanh", ["x"], ["y"])], model.opset_import
        )
    )
    assert "functions" in _refused(_written(tmp_path, model))


@pytest.mark.parametrize("dims", [[2**40], [2**31, 2**31, 2**31], [-1, 4], [0, 2**62]])
def test_a_tensor_that_only_claims_its_size_is_refused(tmp_path, dims):
    model = _small_model()
    model.graph.initializer[1].ClearField("dims")
    model.graph.initializer[1].dims.extend(dims)
    _refused(_written(tmp_path, model))


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
    model = _small_model(nodes=nodes, initializers=[shape])
    assert "'huge'" in _refused(_written(tmp_path, model))


@pytest.mark.parametrize(
    ("domain", "operator"),
    [("", "Loop"), ("", "NonZero"), ("com.microsoft", "Attention"), ("own", "Add"), ("", "")],
)
def test_operators_that_no_network_here_needs_are_refused(tmp_path, domain, operator):
    node = helper.make_node(operator, ["tension_difference_n"], ["direction"], domain=domain)
    assert "uses operator" in _refused(_written(tmp_path, _small_model(nodes=[node])))


def test_a_size_that_depends_on_the_tensions_is_refused(tmp_path):
    nodes = [
        helper.make_node("ReduceSum", ["tension_difference_n"], ["sum"], keepdims=0),
        helper.make_node("Cast", ["sum"], ["shape"], to=TensorProto.INT64),
        helper.make_node("Reshape", ["shape", "one"], ["row"]),
        helper.make_node("Expand", ["last_of", "row"], ["wide"]),
        helper.make_node("ReduceSum", ["wide"], ["direction"], keepdims=0),
    ]
    one = helper.make_tensor("one", TensorProto.INT64, [1], [1])
    model = _small_model(
        nodes=nodes, initializers=[one, helper.make_tensor("last_of", DOUBLE, [1], [1.0])]
    )
    assert "is open until the model is run" in _refused(_written(tmp_path, model))


def test_a_model_that_answers_for_two_samples_alone_is_refused(tmp_path):
    second = helper.make_tensor("second", TensorProto.INT64, [], [1])
    nodes = [
        helper.make_node("Gather", ["tension_difference_n", "second"], ["row"], axis=0),
        helper.make_node("ReduceSum", ["row"], ["once"], keepdims=0),
        helper.make_node("MatMul", ["tension_difference_n", "turn"], ["turned"]),
        helper.make_node("Add", ["turned", "once"], ["direction"]),
    ]
    path = _written(tmp_path, _small_model(nodes=nodes, initializers=[second]))
    with pytest.raises(ModelFileError):
        Estimator.load(path)


def test_more_work_than_a_sample_is_worth_is_refused(tmp_path):
    names = [f"step_{i}" for i in range(600)]
    large = helper.make_tensor("large", DOUBLE, [256, 256], [0.0] * 2**16)
    nodes = [
        helper.make_node("MatMul", [left, "large"], [right])
        for left, right in zip(["large", *names], names, strict=False)
    ]
    assert "multiplications a sample" in _refused(
        _written(tmp_path, _small_model(nodes=nodes, initializers=[large]))
    )


@settings(max_examples=300, deadline=None)
@given(
    st.lists(
        st.tuples(st.floats(0.0, 1.0, exclude_max=True), st.integers(0, 255), st.booleans()),
        min_size=1,
        max_size=4,
    )
)
def test_damaged_bytes_are_refused_or_still_answer(tmp_path_factory, damage):
    content = bytearray(_small_model().SerializeToString())
    for place, byte, whole_graph in damage:
        # most of the bytes are metadata; half of the damage goes to the graph before them
        reach = len(content) if whole_graph else 700
        content[int(place * reach)] = byte
    path = tmp_path_factory.getbasetemp() / "damaged.onnx"
    path.write_bytes(bytes(content))
    _refused_or_finite(path)


def test_a_damaged_model_file_is_refused_or_still_answers(tmp_path):
    whole = find_model("cdsm").read_bytes()
    rng = np.random.default_rng(0)
    for _ in range(20):
        content = bytearray(whole)
        place = rng.integers(len(content))
        content[place : place + rng.integers(1, 4)] = rng.bytes(rng.integers(0, 4))
        _refused_or_finite(_written(tmp_path, bytes(content)))


def _refused_or_finite(path):
    try:
        estimator = Estimator.load(path)
        command = np.zeros(estimator.metadata.arm.joint_count)
        said = estimator.estimate(np.linspace(-3.0, 3.0, len(estimator.cable_names)), command)
    except CableSenseError:
        return
    numbers = [*said.probabilities, said.angle_deg, said.magnitude_n]
    assert np.isfinite([*numbers, said.magnitude_std_n, said.angle_std_deg]).all()


def test_nothing_in_here_imports_torch():
    code = (
        "import sys, pkgutil, importlib, cablesense_training.inference as room\n"
        "for entry in pkgutil.iter_modules(room.__path__):\n"
        "    importlib.import_module(f'{room.__name__}.{entry.name}')\n"
        "sys.exit('torch' in sys.modules or 'rclpy' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
