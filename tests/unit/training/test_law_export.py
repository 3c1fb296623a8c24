"""The law as an ONNX graph answers as PyTorch does, for any number of readings."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from cablesense_contact.inference.session import open_session
from cablesense_contact.law import GRAPH_INPUTS, LawOutput
from cablesense_contact.machine.law import STATED
from cablesense_sim.arm import open_arm
from cablesense_training.errors import TrainingError
from cablesense_training.law.estimator import EstimatorOutput
from cablesense_training.law.statement import Statement
from cablesense_training.law_export import _to_onnx, require_agreement
from tests.helpers.law_arms import LawArm, Push

pytestmark = [pytest.mark.exports, pytest.mark.slow]

ROWS = 7
EQUAL = 1e-6
"""Share of the largest number up to which outputs are equal: inverses lose digits."""
SHARE_OF_STATED = 1e-3
"""The same for statements of place and force, as a share of their stated intervals: where readings
say next to nothing, the densities of many places are equal but for the digits lost."""
STATEMENTS = {
    "place_m": "place_ci95_m",
    "place_ci95_m": "place_ci95_m",
    "region_m": "region_m",
    "magnitude_ci95_n": "magnitude_ci95_n",
}
"""Names of the intervals that outputs are compared with."""


@pytest.fixture(scope="module")
def law():
    return LawArm(open_arm("cdsm_lab"), wraps=(1.0, 0.0), radius_m=0.05, friction=0.3)


@pytest.fixture(scope="module")
def given(law):
    """Untouched, pushed, noisy, some and all cables slack, and saturated."""
    rng = np.random.default_rng(0)
    nothing = np.zeros(len(law.parameters))
    commands = np.stack([law.command(rng) for _ in range(ROWS)])
    readings = np.stack([law.read(nothing, command) for command in commands])
    readings[1] = law.read(nothing, commands[1], [Push(2, 0.05, (1.0, 8.0, -9.0))])
    readings[2] = law.read(nothing, commands[2], [Push(1, 0.1, (0.0, 55.0, -55.0))])
    readings[3] = rng.uniform(0.0, 500.0, readings.shape[1])
    readings[4, ::3] = 0.0
    readings[5] = 0.0
    readings[6] = 1e4
    joints = law.mechanism.joint_count
    covariance = np.diag(law.parameters.prior_std**2)
    return [readings, commands, law.parameters.prior_mean, covariance, np.zeros((joints, joints))]


@pytest.fixture(scope="module")
def session(law, given):
    trial = [np.resize(each, (16, each.shape[1])) for each in given[:2]] + given[2:]
    return open_session(_to_onnx(law.estimator.eval(), [torch.as_tensor(each) for each in trial]))


@pytest.mark.parametrize("rows", [1, ROWS])
def test_the_graph_answers_as_pytorch_does(law, given, session, rows):
    inputs = [each[:rows] if place < 2 else each for place, each in enumerate(given)]
    there = session.run(None, dict(zip(GRAPH_INPUTS, inputs, strict=True)))
    with torch.no_grad():
        here = law.estimator(*(torch.as_tensor(each) for each in inputs))
    of_graph = dict(zip(EstimatorOutput._fields, there, strict=True))
    of_torch = dict(zip(EstimatorOutput._fields, here, strict=True))
    for name, one in of_graph.items():
        other = of_torch[name].numpy()
        assert one.shape == other.shape, name
        assert np.isfinite(one).all(), name
        largest = EQUAL * max(1.0, np.abs(one).max())
        if name in STATEMENTS:
            interval = of_graph[STATEMENTS[name]]
            largest = SHARE_OF_STATED * (interval[:, 1] - interval[:, 0]).min()
        elif name == "contact_covariance":
            largest = SHARE_OF_STATED * np.abs(one).max()
        assert np.abs(one - other).max() <= largest, name


def test_outputs_in_pytorch_have_the_order_of_those_in_a_file():
    assert EstimatorOutput._fields == LawOutput._fields
    assert Statement._fields == STATED


def test_ends_of_an_interval_may_differ_by_a_thousandth_of_its_width():
    wide_m = np.array([[0.02, 0.08], [0.03, 0.031]])
    little = np.array([[4e-5, 0.0], [0.0, 8e-6]])
    require_agreement("place_ci95_m", wide_m + little, wide_m)
    with pytest.raises(TrainingError, match=r"place_ci95_m differs by 4e-05 .* at most 1e-05"):
        require_agreement("place_ci95_m", wide_m + little[::-1, ::-1] + little[::-1], wide_m)
    with pytest.raises(TrainingError, match=r"place_m differs by 8e-06 .* at most 1e-06"):
        require_agreement("place_m", wide_m + 8e-6, wide_m)
