"""One contact from tension differences: alone or in a batch, whatever was asked before."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from onnx import helper

from cablesense_contact.errors import EstimateError, ModelFileError
from cablesense_contact.inference.estimator import Estimator
from cablesense_contact.inference.metadata import find_model
from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.loads import normal_force_n
from tests.helpers.model_fixtures import metadata_for
from tests.helpers.small_models import DOUBLE, small_model, value, written

CDSM = open_arm("cdsm")
STRAIGHT = np.zeros(8)
FIELDS = (
    "probabilities",
    "segment",
    "angle_deg",
    "magnitude_n",
    "magnitude_std_n",
    "angle_std_deg",
    "low_n",
    "high_n",
    "misfit_n",
    "plausible",
)
tensions = st.lists(st.floats(-500.0, 500.0), min_size=12, max_size=12)


@pytest.fixture(scope="module")
def estimator():
    return Estimator.load(find_model("peers/cdsm_straight_two_stage"), CDSM)


@pytest.fixture
def pose_aware(tmp_path):
    """A model that adds the first commanded angle to all forces."""
    inputs = [
        value("tension_difference_n", DOUBLE, ["batch", 12]),
        value("joint_command_rad", DOUBLE, ["batch", 8]),
    ]
    turned = [helper.make_node("MatMul", ["joint_command_rad", "mixed"], ["direction"])]
    mixed = helper.make_tensor("mixed", DOUBLE, [8, 2], np.eye(8, 2).ravel().tolist())
    properties = metadata_for(CDSM, network="small", pose_aware=True).to_properties()
    model = small_model(nodes=turned, initializers=[mixed], inputs=inputs, properties=properties)
    return Estimator.load(written(tmp_path, model), CDSM)


def _require_equal(one, other):
    for field in FIELDS:
        np.testing.assert_allclose(getattr(one, field), getattr(other, field), rtol=1e-9)


def test_a_push_is_told_by_segment_direction_and_force(estimator):
    mechanism = mechanism_of(CDSM)
    for segment in (1, 2, 3, 4):
        forces = normal_force_n(mechanism, STRAIGHT, segment, 250.0, 30.0)
        loaded = solve_equilibrium(mechanism, STRAIGHT, forces).tensions_n
        said = estimator.estimate(loaded - solve_equilibrium(mechanism, STRAIGHT).tensions_n)
        assert said.segment == segment == said.probabilities.argmax()
        assert said.angle_deg == pytest.approx(250.0, abs=3.0)
        assert said.magnitude_n == pytest.approx(30.0, abs=1.5)
        assert said.low_n < said.magnitude_n < said.high_n
        assert said.probabilities.shape == (5,)
        assert said.probabilities.sum() == pytest.approx(1.0)


def test_a_model_of_several_contacts_is_no_estimator_of_one():
    with pytest.raises(ModelFileError, match="multi-contact"):
        Estimator.load(find_model("peers/cdsm_multi_two_stage"))


@settings(max_examples=60, deadline=None)
@given(values=tensions)
def test_whatever_finite_comes_the_answer_is_finite_and_in_its_range(estimator, values):
    said = estimator.estimate(values)
    assert said.segment == said.probabilities.argmax()
    assert said.probabilities.sum() == pytest.approx(1.0)
    assert 0.0 <= said.angle_deg < 360.0
    for number in (said.magnitude_n, said.magnitude_std_n, said.angle_std_deg):
        assert math.isfinite(number)


@settings(max_examples=20, deadline=None)
@given(asked=st.lists(st.tuples(tensions, st.booleans()), min_size=1, max_size=6))
def test_an_answer_does_not_depend_on_what_was_asked_before(estimator, asked):
    batch = estimator.estimate_batch([values for values, _ in asked])
    for row, (values, twice) in enumerate(asked):
        for _ in range(1 + twice):
            said = estimator.estimate(values)
        for field in FIELDS:
            there = getattr(batch, field)[row]
            np.testing.assert_allclose(getattr(said, field), there, rtol=1e-6, atol=1e-9)


def test_a_command_counts_where_the_model_takes_it(pose_aware):
    one = pose_aware.estimate(np.ones(12), [0.1, 0.0, *[0.0] * 6])
    assert one.angle_deg == pytest.approx(90.0)
    two = pose_aware.estimate_batch(np.ones((2, 12)), np.eye(2, 8))
    np.testing.assert_allclose(two.angle_deg, [90.0, 0.0], atol=1e-9)


def test_any_kind_of_array_will_do(estimator):
    values = np.arange(12.0)
    expected = estimator.estimate(values)
    for same in (
        values.tolist(),
        tuple(values),
        values.astype(np.float32),
        values.astype(int),
        np.repeat(values, 2)[::2],
        values[None],
        values.astype(">f8"),
    ):
        _require_equal(estimator.estimate(same), expected)


@pytest.mark.parametrize(
    ("values", "command", "told"),
    [
        (np.zeros(11), np.zeros(8), r"\(11,\); this model needs 12"),
        (np.zeros((0, 12)), np.zeros(8), "at least one row"),
        (np.zeros((2, 12)), np.zeros(8), "this model needs 12"),
        (None, np.zeros(8), "tension differences"),
        ([[1.0], [1.0, 2.0]], np.zeros(8), "must be numbers"),
        (np.full(12, np.nan), np.zeros(8), "tension differences must be finite"),
        (np.zeros(12), None, "8 commanded joint angles"),
        (np.zeros(12), np.zeros(6), r"\(6,\); this model needs 8"),
        (np.zeros(12), np.zeros((2, 8)), "needs 8"),
        (np.zeros(12), np.full(8, -np.inf), "angles must be finite"),
    ],
)
def test_what_cannot_be_taken_is_refused_in_one_line(pose_aware, values, command, told):
    with pytest.raises(EstimateError, match=told) as caught:
        pose_aware.estimate(values, command)
    assert "\n" not in str(caught.value)
