"""Several contacts from tension differences: shapes, ranges, refusals."""

import numpy as np
import pytest

from cablesense_sim.arm import open_arm
from cablesense_sim.build import mechanism_of
from cablesense_sim.equilibrium import solve_equilibrium
from cablesense_sim.loads import normal_force_n
from cablesense_training.inference.estimator import MultiEstimator
from cablesense_training.inference.metadata import ModelFileError, find_model

CDSM = open_arm("cdsm")


@pytest.fixture(scope="module")
def estimator():
    return MultiEstimator.load(find_model("peers/cdsm_multi_two_stage"), CDSM)


@pytest.fixture(scope="module")
def pose_aware():
    return MultiEstimator.load(find_model("cdsm_multi"), CDSM)


def test_rows_do_not_influence_each_other(estimator):
    values = np.random.default_rng(1).normal(0.0, 30.0, (5, 12))
    whole = estimator.estimate_batch(values)
    for row in range(5):
        one = estimator.estimate_batch(values[row])
        np.testing.assert_allclose(one.probabilities[0], whole.probabilities[row], rtol=1e-9)
        np.testing.assert_allclose(one.magnitude_n[0], whole.magnitude_n[row], rtol=1e-9)


def test_a_model_of_one_contact_or_another_arm_is_refused():
    with pytest.raises(ModelFileError, match="single-contact"):
        MultiEstimator.load(find_model("cdsm"))
    with pytest.raises(ModelFileError, match="cdsm_lab"):
        MultiEstimator.load(find_model("cdsm_multi"), open_arm("cdsm_lab"))


def test_two_pushes_at_once_are_told_apart(pose_aware):
    mechanism = mechanism_of(CDSM)
    for seed in range(5):
        command = np.random.default_rng(seed).uniform(-0.17, 0.17, 8)
        forces = normal_force_n(mechanism, command, 2, 70.0, 25.0)
        forces = forces + normal_force_n(mechanism, command, 4, 200.0, 12.0)
        loaded = solve_equilibrium(mechanism, command, forces).tensions_n
        difference = loaded - solve_equilibrium(mechanism, command).tensions_n
        said = pose_aware.estimate_batch(difference, command)
        assert (said.probabilities[0] > 0.5).tolist() == [False, True, False, True]
        assert said.magnitude_n[0, [1, 3]] == pytest.approx([25.0, 12.0], abs=0.1)
