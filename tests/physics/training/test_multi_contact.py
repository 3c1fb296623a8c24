"""Several contacts at once, by the paper's network in a model file."""

import numpy as np
import pytest

from cablesense_contact.errors import EstimateError, ModelFileError
from cablesense_contact.inference.estimator import MultiEstimator
from cablesense_contact.inference.metadata import find_model
from cablesense_sim.arm import open_arm
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.protocols import MultiContact

CDSM = open_arm("cdsm")


@pytest.fixture(scope="module")
def estimator():
    return MultiEstimator.load(find_model("peers/cdsm_multi_two_stage"), CDSM)


def test_touched_segments_are_recognised_and_forces_stated_with_their_errors(estimator):
    dataset = draw_dataset(CDSM, MultiContact(samples=1000), seed=1)
    said = estimator.estimate_batch(dataset.tension_difference_n)
    assert said.probabilities.shape == said.magnitude_n.shape == (1000, 4)
    recognised = said.probabilities > 0.5
    firm = ~dataset.contacts | (dataset.magnitudes_n > 5.0)
    assert (recognised == dataset.contacts)[firm].mean() > 0.99
    right = recognised & dataset.contacts
    off_n = np.abs(said.magnitude_n - dataset.magnitudes_n)[right]
    assert np.median(off_n) < 1.0
    assert 0.9 < (off_n < 1.96 * said.magnitude_std_n[right]).mean() < 0.99


def test_answers_do_not_depend_on_how_many_are_asked_together(estimator):
    tensions = np.random.default_rng(0).normal(0.0, 20.0, (5, 12))
    whole = estimator.estimate_batch(tensions)
    for row, single in enumerate(tensions):
        for all_rows, one in zip(whole, estimator.estimate_batch(single), strict=True):
            np.testing.assert_allclose(one[0], all_rows[row], rtol=1e-9)


@pytest.mark.parametrize("values", [np.zeros(11), np.full(12, np.nan)])
def test_what_cannot_be_taken_is_refused(estimator, values):
    with pytest.raises(EstimateError, match="tension differences"):
        estimator.estimate_batch(values)


def test_a_model_of_one_contact_or_another_arm_is_refused():
    with pytest.raises(ModelFileError, match="single-contact"):
        MultiEstimator.load(find_model("peers/cdsm_two_stage"))
    with pytest.raises(ModelFileError, match="cdsm_lab"):
        MultiEstimator.load(find_model("peers/cdsm_multi_two_stage"), open_arm("cdsm_lab"))
