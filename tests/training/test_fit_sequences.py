"""Training along sequences reduces the errors of friction; unfit data are refused."""

import numpy as np
import pytest
import torch

from cablesense_sim.arm import open_arm
from cablesense_training.data.motion_protocol import MotionProtocol
from cablesense_training.data.sequences import draw_sequences
from cablesense_training.evaluation.metrics import sequence_metrics
from cablesense_training.fit_sequences import SequenceFitSettings, SequenceSamples, fit_sequences
from cablesense_training.networks.temporal import TemporalNetwork

pytestmark = pytest.mark.slow


ARM = open_arm("cdsm_friction")
SETTINGS = SequenceFitSettings(epochs=8, batch_size=8, part_ticks=50, threads=1)


@pytest.fixture(scope="module")
def sequences():
    return draw_sequences(ARM, MotionProtocol(sequences=12, duration_s=3.0), seed=0)


def _network():
    torch.manual_seed(0)
    return TemporalNetwork.for_arm(ARM)


def test_true_torques_are_those_of_statics_where_nothing_touches(sequences):
    samples = SequenceSamples.of(_network(), sequences)
    free = samples.target.segment == 0
    assert (samples.true_torque_n_m[free] == 0.0).all()
    off = (samples.torque_n_m - samples.true_torque_n_m).abs()
    assert off[:, 0].median() < 0.05  # the tare has just been taken
    assert off.max() > 0.2  # friction


def test_the_loss_falls_and_the_best_epoch_is_kept_and_calibrated(sequences):
    network, seen = _network(), []
    history = fit_sequences(network, sequences, SETTINGS, seen.append)
    assert [record.epoch for record in seen] == list(range(1, 9))
    assert history.best_validation == min(record.validation for record in seen)
    assert history.best_validation < seen[0].validation
    assert 0.0 <= network.interval.surely < 1.0


def test_the_same_seed_gives_the_same_network(sequences):
    short = SequenceFitSettings(epochs=1, batch_size=8, threads=1)
    first, second = _network(), _network()
    for network in (first, second):
        fit_sequences(network, sequences.select(slice(0, 6)), short)
    for here, there in zip(first.parameters(), second.parameters(), strict=True):
        torch.testing.assert_close(here, there, rtol=0.0, atol=0.0)


def test_figures_of_a_perfect_answer_are_perfect(sequences):
    from cablesense_training.evaluation.metrics import ContactAnswer

    shape = sequences.segment.size
    figures = sequence_metrics(
        ContactAnswer(
            sequences.segment.ravel(),
            sequences.angle_deg.ravel(),
            sequences.magnitude_n.ravel(),
            np.ones(shape),
            np.ones(shape),
        ),
        sequences,
    )
    assert figures.every.contact_accuracy == 1.0
    assert figures.moving.errors.magnitude_mae_n == 0.0
    assert figures.false_force_n == 0.0
    assert figures.moving.samples + figures.rest.samples == shape
