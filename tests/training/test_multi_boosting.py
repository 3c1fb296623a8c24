"""Boosted trees for several contacts: better than chance, and refuse what teaches nothing."""

import numpy as np
import pytest

from cablesense_sim.arm import open_arm
from cablesense_training.baselines import BoostingSettings, MultiBoostingBaseline
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.protocols import MultiContact
from cablesense_training.errors import TrainingError

ARM = open_arm("cdsm")
QUICK = BoostingSettings(rounds=15, leaves=15)


def test_it_learns_which_segments_are_touched_and_how_hard():
    baseline = MultiBoostingBaseline(draw_dataset(ARM, MultiContact(samples=3000), seed=1), QUICK)
    test = draw_dataset(ARM, MultiContact(samples=500), seed=2)
    touched, force = baseline.answer(test)
    firm = test.magnitudes_n > 10.0
    assert touched.shape == force.shape == (500, 4)
    assert (touched == test.contacts)[firm].mean() > 0.8
    error = np.abs(force - test.magnitudes_n)[firm]
    assert error.mean() < np.abs(test.magnitudes_n[firm] - test.magnitudes_n[firm].mean()).mean()


def test_a_segment_that_is_never_touched_is_refused():
    dataset = draw_dataset(ARM, MultiContact(samples=200), seed=1)
    with pytest.raises(TrainingError, match="segment 4 is touched in 0 of"):
        MultiBoostingBaseline(dataset.select(~dataset.contacts[:, 3]), QUICK)
