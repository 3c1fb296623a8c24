"""Several contacts from tension differences: shapes, ranges, refusals."""

import numpy as np
import pytest

from cablesense_sim.arm_files import open_arm
from cablesense_training.inference.estimator import EstimateError
from cablesense_training.inference.metadata import ModelFileError
from cablesense_training.inference.multi_estimator import MultiEstimator

CDSM = open_arm("cdsm")


@pytest.fixture(scope="module")
def estimator(model_files):
    return MultiEstimator.load(model_files("multi-contact"), CDSM)


def test_every_segment_of_every_sample_gets_an_answer(estimator):
    rng = np.random.default_rng(0)
    said = estimator.estimate_batch(rng.normal(0.0, 30.0, (9, 12)))
    for part in (said.probabilities, said.magnitude_n, said.magnitude_std_n):
        assert part.shape == (9, 4)
        assert np.isfinite(part).all()
    assert ((said.probabilities >= 0.0) & (said.probabilities <= 1.0)).all()
    assert (said.magnitude_std_n > 0.0).all()


def test_rows_do_not_influence_each_other(estimator):
    values = np.random.default_rng(1).normal(0.0, 30.0, (5, 12))
    whole = estimator.estimate_batch(values)
    for row in range(5):
        one = estimator.estimate_batch(values[row])
        np.testing.assert_allclose(one.probabilities[0], whole.probabilities[row], rtol=1e-9)
        np.testing.assert_allclose(one.magnitude_n[0], whole.magnitude_n[row], rtol=1e-9)


def test_a_model_of_one_contact_or_another_arm_is_refused(model_files):
    with pytest.raises(ModelFileError, match="single-contact"):
        MultiEstimator.load(model_files("scale-aware"))
    with pytest.raises(ModelFileError, match="cdsm_lab"):
        MultiEstimator.load(model_files("multi-contact"), open_arm("cdsm_lab"))


@pytest.mark.parametrize(
    "values",
    [
        np.zeros((3, 11)),
        np.zeros((2, 3, 12)),
        np.full((2, 12), np.nan),
        np.full(12, np.inf),
        [[0.0] * 12, [0.0]],
        "twelve",
        None,
    ],
)
def test_what_cannot_be_taken_is_refused(estimator, values):
    with pytest.raises(EstimateError, match="tension differences"):
        estimator.estimate_batch(values)
