"""One contact from tension differences: alone or in a batch, whatever was asked before."""

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.loads import normal_force_n
from cablesense_training.errors import EstimateError, ModelFileError
from cablesense_training.inference.estimator import Estimator
from cablesense_training.inference.metadata import find_model

CDSM = open_arm("cdsm")
FIELDS = (
    "probabilities", "segment", "angle_deg", "magnitude_n", "magnitude_std_n", "angle_std_deg",
)  # fmt: skip
tensions = st.lists(st.floats(-500.0, 500.0), min_size=12, max_size=12)
commands = st.lists(st.floats(-0.3, 0.3), min_size=8, max_size=8)


@pytest.fixture(scope="module")
def estimator():
    return Estimator.load(find_model("cdsm"), CDSM)


def _pushed(command, segment, angle_deg, magnitude_n):
    mechanism = mechanism_of(CDSM)
    forces = normal_force_n(mechanism, command, segment, angle_deg, magnitude_n)
    loaded = solve_equilibrium(mechanism, command, forces).tensions_n
    return loaded - solve_equilibrium(mechanism, command).tensions_n


def _require_equal(one, other):
    for field in FIELDS:
        np.testing.assert_allclose(getattr(one, field), getattr(other, field), rtol=1e-9)


def test_a_push_is_told_by_segment_direction_and_force(estimator):
    rng = np.random.default_rng(0)
    for segment in (1, 2, 3, 4):
        command = rng.uniform(-0.17, 0.17, 8)
        said = estimator.estimate(_pushed(command, segment, 250.0, 30.0), command)
        assert said.segment == segment == said.probabilities.argmax()
        assert said.angle_deg == pytest.approx(250.0, abs=0.2)
        assert said.magnitude_n == pytest.approx(30.0, abs=0.05)
        assert 0.0 < said.magnitude_std_n < 0.2
        assert 0.0 < said.angle_std_deg < 1.0
        assert said.probabilities.shape == (5,)
        assert said.probabilities.sum() == pytest.approx(1.0)


def test_a_model_of_several_contacts_is_no_estimator_of_one():
    with pytest.raises(ModelFileError, match="multi-contact"):
        Estimator.load(find_model("cdsm_multi"))


@settings(max_examples=60, deadline=None)
@given(values=tensions, command=commands)
def test_whatever_finite_comes_the_answer_is_finite_and_in_its_range(estimator, values, command):
    said = estimator.estimate(values, command)
    assert said.segment == said.probabilities.argmax()
    assert said.probabilities.sum() == pytest.approx(1.0)
    assert 0.0 <= said.angle_deg < 360.0
    for number in (said.magnitude_n, said.magnitude_std_n, said.angle_std_deg):
        assert math.isfinite(number)
        assert number >= 0.0


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(asked=st.lists(st.tuples(tensions, commands, st.booleans()), min_size=1, max_size=6))
def test_an_answer_does_not_depend_on_what_was_asked_before(estimator, asked):
    batch = estimator.estimate_batch([t for t, _, _ in asked], [c for _, c, _ in asked])
    for row, (values, command, twice) in enumerate(asked):
        for _ in range(1 + twice):
            said = estimator.estimate(values, command)
        there = {field: getattr(batch, field)[row] for field in FIELDS}
        # the direction of a force of nanonewtons is that of a rounding error
        told = FIELDS if said.magnitude_n > 1e-3 else ("probabilities", "segment")
        for field in told:
            np.testing.assert_allclose(getattr(said, field), there[field], rtol=1e-6, atol=1e-9)
        assert said.magnitude_n == pytest.approx(there["magnitude_n"], rel=1e-6, abs=1e-4)


def test_a_refused_command_leaves_the_next_answer_alone(estimator):
    difference, command = _pushed(np.full(8, 0.1), 2, 30.0, 20.0), np.full(8, 0.1)
    before = estimator.estimate(difference, command)
    for wrong in (np.full(8, np.nan), np.zeros(7), None):
        with pytest.raises(EstimateError):
            estimator.estimate(difference, wrong)
    _require_equal(estimator.estimate(difference, command), before)


def test_any_kind_of_array_will_do(estimator):
    values, command = np.arange(12.0), np.full(8, 0.05)
    expected = estimator.estimate(values, command)
    for same in (
        values.tolist(),
        tuple(values),
        values.astype(np.float32),
        values.astype(int),
        np.repeat(values, 2)[::2],
        values[None],
        values.astype(">f8"),
    ):
        _require_equal(estimator.estimate(same, command[None]), expected)


NAN, INFINITE = np.full(12, np.nan), np.full(12, np.inf)


@pytest.mark.parametrize(
    ("values", "command", "told"),
    [
        (np.zeros(11), np.zeros(8), r"\(11,\); this model needs 12"),
        (np.zeros((0, 12)), np.zeros(8), "at least one row"),
        (None, np.zeros(8), "tension differences"),
        ([[1.0], [1.0, 2.0]], np.zeros(8), "must be numbers"),
        (NAN, np.zeros(8), "tension differences must be finite"),
        (np.zeros(12), None, "8 commanded joint angles"),
        (np.zeros(12), np.zeros(6), r"\(6,\); this model needs 8"),
        (np.zeros(12), np.zeros((2, 8)), "needs 8"),
        (np.zeros(12), -INFINITE[:8], "angles must be finite"),
    ],
)
def test_what_cannot_be_taken_is_refused_in_one_line(estimator, values, command, told):
    with pytest.raises(EstimateError, match=told) as caught:
        estimator.estimate(values, command)
    assert "\n" not in str(caught.value)
