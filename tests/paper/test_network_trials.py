"""A trial is the same again with the same seed, here or in another process."""

import pytest

from cablesense_paper.network_findings import Shape
from cablesense_paper.network_trials import trials
from cablesense_sim.arm import open_arm
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.protocols import SingleContact
from cablesense_training.fit import FitSettings


@pytest.mark.slow  # two processes load PyTorch
def test_a_seed_gives_the_same_figures_for_any_number_of_workers():
    protocol = SingleContact(samples=64)
    samples = [draw_dataset(open_arm("cdsm"), protocol, seed) for seed in (0, 1)]
    cases = [(Shape("shared trunk", 1, 4), seed) for seed in (0, 1)]
    here, elsewhere = (
        list(trials(cases, *samples, FitSettings(epochs=1, batch_size=64), workers))
        for workers in (1, 2)
    )
    assert here == elsewhere
    assert here[0].magnitude_mae_n != here[1].magnitude_mae_n
    assert [one.seed for one in here] == [0, 1]
