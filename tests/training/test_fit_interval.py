"""What is stated of errors holds on data of their kind, lopsided or in doubt as they are."""

import torch

from cablesense_training.fit_sequences import Answered, fit_interval
from cablesense_training.losses import SingleContactTarget
from cablesense_training.networks.layers import SingleContactOutput
from cablesense_training.networks.temporal import StatedInterval

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
