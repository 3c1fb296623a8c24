"""A graph split into parts, and one sample at a time, give what the whole graph gives."""

import numpy as np
import onnx
import onnxruntime
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from onnx import TensorProto, helper

from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.loads import normal_force_n
from cablesense_training.inference.estimator import Estimator
from cablesense_training.inference.metadata import find_model
from cablesense_training.inference.model_file import store_as_single, widen_constants
from cablesense_training.inference.session import COMMAND, TAUT, TENSION, SingleRun, split_graph

CDSM = open_arm("cdsm")
POSES, PUSHES = 3, 12


def _model(nodes, outputs):
    def values(names):
        return [helper.make_tensor_value_info(n, TensorProto.DOUBLE, [None, 3]) for n in names]

    one = helper.make_tensor("one", TensorProto.DOUBLE, [1, 3], [1.0, 2.0, 3.0])
    inputs = values((TENSION, COMMAND))
    graph = helper.make_graph(nodes, "test", inputs, values(outputs), initializer=[one])
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)


def _run(model, inputs):
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4
    session = onnxruntime.InferenceSession(
        model.SerializeToString(), options, providers=["CPUExecutionProvider"]
    )
    wanted = {entry.name for entry in session.get_inputs()}
    names = [entry.name for entry in session.get_outputs()]
    values = session.run(names, {k: v for k, v in inputs.items() if k in wanted})
    return dict(zip(names, values, strict=True))


def _require_agreement(model, inputs, held=None):
    """Every part runs on the results of earlier parts; `held` has the whole graph's value."""
    whole = _run(model, inputs)
    parts = split_graph(model, TENSION, held)
    known = {COMMAND: inputs[COMMAND]}
    if parts.steady is not None:
        assert {entry.name for entry in parts.steady.graph.input} <= {COMMAND}
        known |= _run(parts.steady, known)
    if parts.held is not None:
        known |= _run(parts.held, known | {held: whole[held]})
    assert TENSION not in known
    found = _run(parts.moving, known | {TENSION: inputs[TENSION]})
    assert list(found) == list(whole)
    for name, value in whole.items():
        np.testing.assert_allclose(found[name], value, rtol=1e-12, atol=1e-12)
    return parts


@st.composite
def graphs(draw):
    """Operators that each take earlier results; any of the results may be outputs."""
    names, nodes = [TENSION, COMMAND, "one"], []
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
    made = names[3:]
    outputs = draw(st.lists(st.sampled_from(made), min_size=1, max_size=3, unique=True))
    return _model(nodes, outputs)


@pytest.mark.slow
@settings(max_examples=30, deadline=None)
@given(graphs(), st.integers(0, 2**32 - 1), st.booleans())
def test_parts_agree_with_the_whole_for_any_graph(model, seed, holds):
    rng = np.random.default_rng(seed)
    inputs = {TENSION: rng.normal(size=(2, 3)), COMMAND: rng.normal(size=(2, 3))}
    held = model.graph.output[0].name if holds else None
    if held:
        changed = _run(model, inputs | {TENSION: 1.0 + inputs[TENSION]})
        assume((_run(model, inputs)[held] != changed[held]).any())
    parts = _require_agreement(model, inputs, held)
    assert holds or parts.held is None


def test_the_shipped_model_is_split_and_one_of_tensions_alone_is_not():
    rng = np.random.default_rng(1)
    samples = {TENSION: rng.normal(0.0, 30.0, (50, 12)), COMMAND: rng.uniform(-0.3, 0.3, (50, 8))}
    model = onnx.load(find_model("cdsm"))
    parts = _require_agreement(model, samples, held=TAUT)
    assert len(parts.moving.graph.node) < len(model.graph.node) / 4
    alone = onnx.load(find_model("cdsm_tensions_only"))
    widen_constants(alone.graph)
    assert split_graph(alone, TENSION).moving is alone


def test_constants_stored_in_single_precision_lose_nothing():
    model = onnx.load(find_model("cdsm_tensions_only"))
    tensions = {TENSION: np.random.default_rng(2).normal(0.0, 30.0, (20, 12))}
    stored = _run(model, tensions)
    widen_constants(model.graph)
    wide, size = _run(model, tensions), model.ByteSize()
    store_as_single(model.graph)
    assert model.ByteSize() < 0.6 * size
    for name, values in _run(model, tensions).items():
        assert (values == stored[name]).all()
        assert (values == wide[name]).all()


@pytest.fixture(scope="module")
def session():
    session = Estimator.load(find_model("cdsm"), CDSM)
    assert TAUT in session.beside
    return session


@pytest.fixture(scope="module")
def single(session):
    return SingleRun(session.model, CDSM, session.outputs, "cdsm")


@pytest.fixture(scope="module")
def readings():
    """Commands (POSES, 8) and differences (POSES, PUSHES, 12) of pushes that slacken many sets."""
    mechanism = mechanism_of(CDSM)
    rng = np.random.default_rng(0)
    commands = rng.uniform(-0.17, 0.17, (POSES, 1, 8))
    forces = normal_force_n(
        mechanism,
        np.broadcast_to(commands, (POSES, PUSHES, 8)),
        rng.integers(1, 5, (POSES, PUSHES)),
        rng.uniform(0.0, 360.0, (POSES, PUSHES)),
        rng.uniform(5.0, 200.0, (POSES, PUSHES)),
    )
    loaded = solve_equilibrium(mechanism, commands, forces).tensions_n
    assert len({tuple(row) for row in (loaded == 0.0).reshape(-1, 12)}) > 10
    return commands[:, 0], loaded - solve_equilibrium(mechanism, commands).tensions_n


asked = st.lists(
    st.tuples(st.integers(0, POSES - 1), st.integers(0, PUSHES - 1)), min_size=1, max_size=12
)


@settings(max_examples=30, deadline=None)
@given(asked=asked)
def test_an_answer_does_not_depend_on_which_cables_were_slack_before(
    single, session, readings, asked
):
    commands, differences = readings
    last = None
    for pose, push in asked:
        if pose != last:
            single.set_command(commands[pose][None])
            last = pose
        single.tension_difference_n[:] = differences[pose, push]
        single.run()
        sample = {TENSION: differences[pose, push][None], COMMAND: commands[pose][None]}
        for said, whole in zip(single.outputs, session.run(sample), strict=True):
            np.testing.assert_allclose(said, whole[0], rtol=1e-9, atol=1e-9)
