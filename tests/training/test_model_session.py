"""A file that is no fitting model is refused in one line; whatever opens, answers."""

import os
import subprocess
import sys

import numpy as np
import pytest
from arm_variants import variant
from hypothesis import given, settings
from hypothesis import strategies as st
from onnx import TensorProto, helper
from small_models import CDSM, DOUBLE, FLOAT, refused, small_model, value, weights, written

from cablesense_base import CableSenseError
from cablesense_sim.arm import open_arm
from cablesense_training.inference.estimator import MULTI_OUTPUTS as MULTI_OUTPUTS
from cablesense_training.inference.estimator import OUTPUTS, Estimator
from cablesense_training.inference.metadata import ModelFileError, find_model
from cablesense_training.inference.session import (
    MAX_FILE_BYTES,
    TAUT,
    TENSION,
    ModelSession,
)


def test_a_model_may_tell_beside_its_answers_which_cables_are_taut(tmp_path):
    model = small_model(nodes=[helper.make_node("Sign", ["tension_difference_n"], [TAUT])])
    taut = value(TAUT, DOUBLE, ["batch", 12])
    model.graph.output.append(taut)
    session = ModelSession.open(written(tmp_path, model), OUTPUTS, CDSM)
    assert session.beside == [TAUT]
    assert len(session.run({TENSION: np.ones((3, 12))})) == len(OUTPUTS)
    model.graph.output.append(taut)
    assert TAUT in refused(written(tmp_path, model))


def test_a_model_that_tells_something_else_is_refused(tmp_path):
    model = small_model(nodes=[helper.make_node("Sign", ["tension_difference_n"], ["sign"])])
    model.graph.output.append(value("sign", DOUBLE, ["batch", 12]))
    assert "sign" in refused(written(tmp_path, model))


@pytest.mark.parametrize(("kind", "width"), [(FLOAT, 12), (DOUBLE, 7)])
def test_taut_cables_told_in_another_type_or_number_are_refused(tmp_path, kind, width):
    model = small_model()
    model.graph.initializer.append(weights("pull", 12, width))
    model.graph.node.append(helper.make_node("MatMul", ["tension_difference_n", "pull"], ["told"]))
    model.graph.node.append(helper.make_node("Cast", ["told"], [TAUT], to=kind))
    model.graph.output.append(value(TAUT, kind, ["batch", width]))
    assert TAUT in refused(written(tmp_path, model))


def test_no_file_is_said_to_be_none(tmp_path):
    assert "No such file" in refused(tmp_path / "none.onnx")
    assert "not a file" in refused(tmp_path)


@pytest.mark.parametrize("content", [b"", b"\x00", b"not a model", os.urandom(5000)])
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
    path, odd = written(tmp_path, small_model()), variant({"effects": [gain]})
    assert odd.identity != CDSM.identity
    assert ModelSession.open(path, OUTPUTS, odd).metadata.arm_identity == CDSM.identity
    assert CDSM.identity in refused(path, arm=variant({"effects": [gain]}, "cdsm_lab"))


def test_other_outputs_than_needed_are_listed(tmp_path):
    message = refused(written(tmp_path, small_model()), outputs=MULTI_OUTPUTS)
    assert "direction" in message
    assert "contact_probability, magnitude_n, magnitude_std_n" in message


def test_single_precision_is_refused(tmp_path):
    assert "FLOAT" in refused(written(tmp_path, small_model(kind=FLOAT)))


@pytest.mark.parametrize(
    "inputs",
    [
        [value("tension_difference_n", DOUBLE, ["batch", 9])],
        [value("tension_difference_n", 2**20, ["batch", 12])],
        [value("tension_difference_n", DOUBLE, [1, 12])],
        [value("tension_difference_n", DOUBLE, [12])],
        [value("tension_difference_n", DOUBLE, ["a", "b", 12])],
        [value("tension_difference_n", DOUBLE, None)],
        [
            value("tension_difference_n", DOUBLE, ["batch", 12]),
            value("joint_command_rad", DOUBLE, ["batch", 8]),
        ],
        [
            value("tension_difference_n", DOUBLE, ["batch", 12]),
            value("temperature", DOUBLE, ["batch", 1]),
        ],
    ],
    ids=["nine cables", "no type", "single", "vector", "cube", "any shape", "command", "heat"],
)
def test_other_inputs_than_the_metadata_say_are_refused(tmp_path, inputs):
    message = refused(written(tmp_path, small_model(inputs=inputs)))
    assert "its metadata need tension_difference_n" in message or "not a valid" in message


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
    refused(written(tmp_path, small_model(nodes=nodes)))


def test_a_model_that_answers_for_two_samples_alone_is_refused(tmp_path):
    second = helper.make_tensor("second", TensorProto.INT64, [], [1])
    nodes = [
        helper.make_node("Gather", ["tension_difference_n", "second"], ["row"], axis=0),
        helper.make_node("ReduceSum", ["row"], ["once"], keepdims=0),
        helper.make_node("MatMul", ["tension_difference_n", "turn"], ["turned"]),
        helper.make_node("Add", ["turned", "once"], ["direction"]),
    ]
    path = written(tmp_path, small_model(nodes=nodes, initializers=[second]))
    with pytest.raises(ModelFileError):
        Estimator.load(path)


@pytest.mark.slow
@settings(max_examples=300, deadline=None)
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


@pytest.mark.slow
def test_a_damaged_model_file_is_refused_or_still_answers(tmp_path):
    whole = find_model("cdsm").read_bytes()
    rng = np.random.default_rng(0)
    for _ in range(20):
        content = bytearray(whole)
        place = rng.integers(len(content))
        content[place : place + rng.integers(1, 4)] = rng.bytes(rng.integers(0, 4))
        _refused_or_finite(written(tmp_path, bytes(content)))


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


@pytest.mark.slow
def test_nothing_in_here_imports_torch():
    code = (
        "import sys, pkgutil, importlib, cablesense_training.inference as room\n"
        "for entry in pkgutil.iter_modules(room.__path__):\n"
        "    importlib.import_module(f'{room.__name__}.{entry.name}')\n"
        "sys.exit('torch' in sys.modules or 'rclpy' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
