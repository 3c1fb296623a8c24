"""A file that is no fitting model is refused in one line; whatever opens, answers."""

import json

import numpy as np
import onnx
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from onnx import TensorProto, helper

from cablesense_base import CableSenseError
from cablesense_contact.errors import ModelFileError
from cablesense_contact.inference.estimator import Estimator, MultiEstimator
from cablesense_contact.inference.metadata import (
    FORMAT,
    REMOVED_NETWORKS,
    ModelMetadata,
    effect_versions,
)
from cablesense_contact.inference.model_file import MAX_FILE_BYTES
from cablesense_sim.arm import open_arm
from tests.helpers.arm_variants import variant
from tests.helpers.model_fixtures import metadata_for
from tests.helpers.small_models import CDSM, DOUBLE, FLOAT, refused, small_model, value, written


def test_further_outputs_than_those_needed_are_refused(tmp_path):
    model = small_model(nodes=[helper.make_node("Sign", ["tension_difference_n"], ["taut"])])
    model.graph.output.append(value("taut", DOUBLE, ["batch", 12]))
    assert "gives contact_probability" in refused(written(tmp_path, model))


def test_no_file_is_said_to_be_none(tmp_path):
    assert "No such file" in refused(tmp_path / "none.onnx")
    assert "not a file" in refused(tmp_path)


@pytest.mark.parametrize("content", [b"", b"\x00", b"not a model", bytes(range(256)) * 4])
def test_other_content_is_refused(tmp_path, content):
    refused(written(tmp_path, content))


def test_a_huge_file_is_refused_unread(tmp_path):
    path = tmp_path / "huge.onnx"
    with path.open("wb") as file:
        file.truncate(MAX_FILE_BYTES + 1)
    assert "larger" in refused(path)


def test_a_model_of_another_arm_names_both(tmp_path):
    lab = open_arm("cdsm_lab")
    message = refused(written(tmp_path, small_model()), arm=lab)
    assert CDSM.identity in message
    assert lab.identity in message


def test_a_model_of_the_arm_without_its_effects_fits_one_with_them(tmp_path):
    gain = {"effect": "sensor_gain", "at": "cable_1", "parameters": {"gain": 0.1}}
    path = written(tmp_path, small_model())
    odd = variant({"effects": [gain]})
    assert odd.identity != CDSM.identity
    assert Estimator.load(path, odd).metadata.arm_identity == CDSM.identity
    assert CDSM.identity in refused(path, arm=variant({"effects": [gain]}, "cdsm_lab"))


def test_other_outputs_than_needed_are_listed(tmp_path):
    message = refused(written(tmp_path, small_model()), kind=MultiEstimator)
    assert "direction" in message
    assert "contact_probability, magnitude_n, magnitude_std_n" in message


def test_single_precision_is_refused(tmp_path):
    assert "float" in refused(written(tmp_path, small_model(kind=FLOAT)))


READINGS = value("tension_difference_n", DOUBLE, ["batch", 12])


@pytest.mark.parametrize(
    "inputs",
    [
        [value("tension_difference_n", DOUBLE, ["batch", 9])],
        [value("tension_difference_n", DOUBLE, [1, 12])],
        [READINGS, value("joint_command_rad", DOUBLE, ["batch", 8])],
        [READINGS, value("temperature", DOUBLE, ["batch", 1])],
    ],
    ids=["nine cables", "single", "command", "heat"],
)
def test_other_inputs_than_the_metadata_say_are_refused(tmp_path, inputs):
    refused(written(tmp_path, small_model(inputs=inputs)))


@pytest.mark.parametrize(
    "nodes",
    [
        [helper.make_node("Identity", ["tension_difference_n"], ["direction"])],
        [helper.make_node("Identity", ["tension_difference_n"], ["magnitude_n"])],
        [helper.make_node("Cast", ["logits"], ["contact_probability"], to=FLOAT)],
        [helper.make_node("Log", ["magnitude_n"], ["angle_std_deg"])],
        [helper.make_node("Tanh", ["angle_std_deg"], ["logits"])],
        [helper.make_node("Transmogrify", ["tension_difference_n"], ["direction"])],
        [helper.make_node("Evil", ["tension_difference_n"], ["direction"], domain="elsewhere")],
    ],
    ids=["too wide", "too many", "float", "not finite", "cycle", "unknown", "foreign"],
)
def test_a_graph_that_cannot_answer_is_refused(tmp_path, nodes):
    refused(written(tmp_path, small_model(nodes=nodes)))


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.tuples(st.floats(0.0, 1.0, exclude_max=True), st.integers(0, 255), st.booleans()),
        min_size=1,
        max_size=4,
    )
)
def test_damaged_bytes_are_refused_or_still_answer(tmp_path_factory, damage):
    content = bytearray(small_model().SerializeToString())
    for place, byte, whole_graph in damage:
        # most of the bytes are metadata; half of the damage goes to the graph before them
        reach = len(content) if whole_graph else 700
        content[int(place * reach)] = byte
    path = tmp_path_factory.getbasetemp() / "damaged.onnx"
    path.write_bytes(bytes(content))
    _refused_or_finite(path)


def _refused_or_finite(path):
    try:
        estimator = Estimator.load(path)
        command = np.zeros(estimator.metadata.arm.joint_count)
        said = estimator.estimate(
            np.linspace(-3.0, 3.0, estimator.metadata.arm.cable_count), command
        )
    except CableSenseError:
        return
    numbers = [*said.probabilities, said.angle_deg, said.magnitude_n]
    assert np.isfinite([*numbers, said.magnitude_std_n, said.angle_std_deg]).all()


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
    assert "graph inside" in refused(written(tmp_path, model))
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
    last = helper.make_tensor("last_of", DOUBLE, [1], [1.0])
    model = small_model(nodes=nodes, initializers=[one, last])
    assert "is open until the model is run" in refused(written(tmp_path, model))


def test_more_work_than_a_sample_is_worth_is_refused(tmp_path):
    names = [f"step_{i}" for i in range(600)]
    large = helper.make_tensor("large", DOUBLE, [256, 256], [0.0] * 2**16)
    nodes = [
        helper.make_node("MatMul", [left, "large"], [right])
        for left, right in zip(["large", *names], names, strict=False)
    ]
    model = small_model(nodes=nodes, initializers=[large])
    assert "multiplications a sample" in refused(written(tmp_path, model))


def _changed(change):
    """Properties whose JSON content was altered."""
    [(key, text)] = metadata_for(CDSM).to_properties().items()
    content = json.loads(text)
    change(content)
    return {key: json.dumps(content)}


def _refused_description(properties):
    with pytest.raises(ModelFileError) as caught:
        ModelMetadata.from_properties(properties, "arm.onnx")
    message = str(caught.value)
    assert message.startswith("arm.onnx: ")
    assert "\n" not in message
    return message


def test_a_model_that_was_trained_on_an_older_law_is_refused_with_the_remedy():
    metadata = metadata_for(open_arm("cdsm_friction"))
    current = metadata.model_copy(update={"effect_versions": effect_versions(metadata.arm)})
    assert ModelMetadata.from_properties(current.to_properties(), "arm.onnx") == current
    refusal = _refused_description(metadata.to_properties())
    assert "version 1 of the law of capstan_friction" in refusal
    assert refusal.endswith(f"train it again: {metadata.command}")


@pytest.mark.parametrize("version", ["cablesense-model/2", None])
def test_another_format_names_both(version):
    message = _refused_description(_changed(lambda content: content.update(format=version)))
    assert repr(version) in message
    assert FORMAT in message


@pytest.mark.parametrize("name", REMOVED_NETWORKS)
def test_a_model_of_a_network_of_earlier_versions_names_what_makes_the_estimator_now(name):
    message = _refused_description(_changed(lambda content: content.update(network=name)))
    assert f"network {name} was " in message
    assert "cablesense export --arm" in message


def test_an_altered_arm_is_noticed():
    def heavier(content):
        content["arm"]["segments"]["mass_kg"] = 0.6

    assert "altered" in _refused_description(_changed(heavier))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("kind", "double-contact"),
        ("pose_range_deg", float("nan")),
        ("arm", {"name": "x"}),
        ("cable_names", 12),
        ("invented", 1),
    ],
)
def test_a_value_that_cannot_be_true_is_named(key, value):
    assert key in _refused_description(_changed(lambda content: content.update({key: value})))
