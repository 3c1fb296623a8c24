"""A trial is the same again with the same seed, here or in another process."""

import pytest

from cablesense_paper.networks.shapes import Shape
from cablesense_paper.networks.trials import answer_us, trials
from cablesense_sim.arm_files import open_arm
from cablesense_training.data.dataset import Dataset
from cablesense_training.data.protocols import SingleContact
from cablesense_training.fit import FitSettings

pytestmark = pytest.mark.slow  # trains

ARM = open_arm("cdsm")
SHAPE = Shape("shared trunk", 1, 8)
HOW = FitSettings(epochs=2, batch_size=64)


@pytest.fixture(scope="module")
def samples():
    return [Dataset.from_protocol(ARM, SingleContact(samples=256), seed) for seed in (0, 1)]


def test_a_seed_gives_the_same_figures_for_any_number_of_workers(samples):
    cases = [(SHAPE, 0), (SHAPE, 1)]
    here = list(trials(cases, *samples, HOW, workers=1))
    elsewhere = list(trials(cases, *samples, HOW, workers=2))
    assert here == elsewhere
    assert here[0].magnitude_mae_n != here[1].magnitude_mae_n
    assert [one.seed for one in here] == [0, 1]


def test_an_answer_takes_microseconds():
    assert 1.0 < answer_us(SHAPE, ARM) < 5_000.0
