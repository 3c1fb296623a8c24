"""Training along sequences, and the interval that is stated of the answers."""

import pytest
import torch

from cablesense_sim.arm import open_arm
from cablesense_training import fit_sequences
from cablesense_training.data.sequences import MotionProtocol, draw_sequences
from cablesense_training.fit import FitSettings, SingleContactTarget
from cablesense_training.fit_sequences import Answered, SequenceSamples, fit_interval
from cablesense_training.networks.layers import SingleContactOutput
from cablesense_training.networks.temporal import StatedInterval, TemporalNetwork

pytestmark = pytest.mark.slow


ARM = open_arm("cdsm_friction")
SETTINGS = FitSettings(epochs=8, batch_size=8, learning_rate=3e-3, part_ticks=50, threads=1)


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


def test_the_loss_falls_and_the_best_epoch_is_kept_and_calibrated(sequences, monkeypatch):
    monkeypatch.setattr(fit_sequences, "_STEPS", 50)
    network, seen = _network(), []
    history = fit_sequences.fit_sequences(network, sequences, SETTINGS, seen.append)
    assert [record.epoch for record in seen] == list(range(1, 9))
    assert history.best_validation == min(record.validation for record in seen)
    assert history.best_validation < seen[0].validation
    assert 0.0 <= network.interval.surely < 1.0


SEQUENCES, TICKS, SEGMENTS = 30, 200, 2


def _answered(seed):
    """Answers that know whether friction acts; then more acts than they find, or a ghost."""
    draw = torch.Generator().manual_seed(seed)
    count = SEQUENCES * TICKS
    hides = torch.rand(count, generator=draw) < 0.5
    touched = torch.rand(count, generator=draw) < 0.6
    touched |= ~hides  # a contact is certain, or seems to be one
    magnitude_n = 1.0 + 50.0 * torch.rand(count, generator=draw).double()
    share = torch.where(hides, 1.0 + torch.rand(count, generator=draw), 1.0)
    off_n = 0.3 * torch.randn(count, generator=draw)
    true_n = (magnitude_n * share + off_n) * touched
    output = SingleContactOutput(
        contact_logits=torch.zeros(count, SEGMENTS + 1).double(),
        direction=torch.tensor([[0.0, 1.0]]).double().expand(count, 2),
        magnitude_n=magnitude_n,
        magnitude_std_n=torch.ones(count).double(),
        angle_std_deg=torch.ones(count).double(),
    )
    angle_deg = 10.0 * torch.randn(count, generator=draw).double()
    seen = torch.stack([hides.float(), torch.asinh(magnitude_n).float()], dim=-1)
    seen = torch.cat([seen, torch.zeros(count, 2 * SEGMENTS + 2)], dim=-1)
    target = SingleContactTarget(touched.long(), angle_deg, true_n)
    sequence = torch.arange(SEQUENCES).repeat_interleave(TICKS)
    return Answered(sequence, seen, output, target), hides


def test_intervals_hold_are_lopsided_and_begin_at_nothing_where_there_may_be_none():
    interval = StatedInterval(SEGMENTS)
    fit_interval(interval, _answered(0)[0], torch.Generator().manual_seed(0))
    fresh, hides = _answered(1)
    with torch.no_grad():
        stated, interval_n = interval.stated(fresh.seen, fresh.output)
    (low_n, high_n), true_n = interval_n.T, fresh.target.magnitude_n
    touched = fresh.target.segment > 0
    holds = ((low_n <= true_n) & (true_n <= high_n)).float()
    for rows in (touched & hides, touched & ~hides):
        assert 0.92 < holds[rows].mean() < 0.995
    assert (low_n[hides] == 0.0).float().mean() > 0.95
    assert (low_n[~hides & (true_n > 10.0)] > 0.0).float().mean() > 0.95
    above = (high_n - fresh.output.magnitude_n)[touched]
    assert above[hides[touched]].mean() > 3.0 * above[~hides[touched]].mean()
    none = torch.softmax(stated.contact_logits, dim=-1)[:, 0]
    assert abs(float(none[hides].mean()) - 0.4) < 0.05
    off_deg = fresh.target.angle_deg.abs()
    assert 0.92 < (off_deg <= 1.96 * stated.angle_std_deg)[~hides].float().mean() < 0.98
