"""Boosted trees learn one contact and several, better than chance."""

import dataclasses

import numpy as np
import pytest

from cablesense_base.installation import config_path
from cablesense_sim.arm import load_arm
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.protocols import MultiContact, SingleContact
from cablesense_training.evaluation.metrics import ContactTruth, single_contact_metrics
from examples.paper.boosting import BoostingBaseline, BoostingSettings, MultiBoostingBaseline

ARM = load_arm(config_path("arms/cdsm.yaml"))
SMALL = BoostingSettings(rounds=20, leaves=31)


@pytest.fixture(scope="module")
def data():
    samples = draw_dataset(ARM, SingleContact(samples=4000), seed=0)
    return samples.select(slice(0, 3000)), samples.select(slice(3000, 4000))


@pytest.mark.slow
@pytest.mark.parametrize("pose_aware", [False, True])
def test_finds_most_contacts_and_roughly_their_force(data, pose_aware):
    training, test = data
    baseline = BoostingBaseline(training, dataclasses.replace(SMALL, pose_aware=pose_aware))
    found = single_contact_metrics(ContactTruth.of(test), baseline.answer(test), 4)
    assert found.contact_accuracy > 0.9
    assert found.errors.direction_mae_deg < 20.0
    assert found.errors.magnitude_mae_n < 20.0
    assert 0.88 < found.coverage95 < 0.99


QUICK = BoostingSettings(rounds=15, leaves=15)


@pytest.mark.slow
def test_it_learns_which_segments_are_touched_and_how_hard():
    baseline = MultiBoostingBaseline(draw_dataset(ARM, MultiContact(samples=3000), seed=1), QUICK)
    test = draw_dataset(ARM, MultiContact(samples=500), seed=2)
    touched, force = baseline.answer(test)
    firm = test.magnitudes_n > 10.0
    assert touched.shape == force.shape == (500, 4)
    assert (touched == test.contacts)[firm].mean() > 0.8
    error = np.abs(force - test.magnitudes_n)[firm]
    assert error.mean() < np.abs(test.magnitudes_n[firm] - test.magnitudes_n[firm].mean()).mean()
