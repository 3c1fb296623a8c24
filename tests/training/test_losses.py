"""Losses against values worked out by hand."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from cablesense_training.fit import (
    MultiContactTarget,
    SingleContactTarget,
    angle_error_deg,
    direction_of,
    multi_contact_loss,
    single_contact_loss,
)
from cablesense_training.fit_sequences import pinball
from cablesense_training.networks.layers import MultiContactOutput, SingleContactOutput

ANGLES = st.floats(-720.0, 720.0)


def _output(logits, angle_deg, magnitude_n, std=1.0):
    magnitude = torch.tensor(magnitude_n)
    return SingleContactOutput(
        contact_logits=torch.tensor(logits),
        direction=direction_of(torch.tensor(angle_deg)),
        magnitude_n=magnitude,
        magnitude_std_n=torch.full_like(magnitude, std),
        angle_std_deg=torch.full_like(magnitude, std),
    )


def _target(segment, angle_deg, magnitude_n):
    return SingleContactTarget(
        torch.tensor(segment), torch.tensor(angle_deg), torch.tensor(magnitude_n)
    )


def test_direction_loss_is_squared_chord_over_touched_samples_only():
    output = _output([[0.0, 0.0]] * 3, [60.0, 0.0, 123.0], [10.0] * 3)
    terms = single_contact_loss(
        output, _target([1, 1, 0], [0.0, 180.0, 0.0], [10.0, 10.0, 0.0]), torch.tensor(50.0)
    )
    # a chord of 60 degrees is 1 long, one of 180 degrees is 2 long
    assert float(terms.direction) == pytest.approx((1.0 + 4.0) / 2.0)


def test_magnitude_loss_is_l1_in_standard_deviations_over_the_contacts():
    output = _output([[9.0, 0.0], [0.0, 9.0], [0.0, 9.0]], [0.0] * 3, [10.0, 100.0, 20.0])
    target = _target([0, 1, 1], [0.0] * 3, [0.0, 60.0, 30.0])
    terms = single_contact_loss(output, target, torch.tensor(50.0))
    assert float(terms.magnitude) == pytest.approx((40.0 / 50.0 + 10.0 / 50.0) / 2.0)


def test_spread_loss_leaves_the_answers_alone():
    output = _output([[0.0, 1.0]], [30.0], [10.0])
    output.magnitude_n.requires_grad_()
    stds = torch.ones(1, requires_grad=True)
    output = output._replace(magnitude_std_n=stds, angle_std_deg=stds)
    terms = single_contact_loss(output, _target([1], [0.0], [20.0]), torch.tensor(10.0))
    terms.spread.backward()
    assert output.magnitude_n.grad is None
    assert stds.grad is not None


@given(true=ANGLES, answered=ANGLES, turn=ANGLES, length=st.floats(0.01, 100.0))
def test_angle_error_is_periodic_odd_and_blind_to_length(true, answered, turn, length):
    def error(a, b):
        direction = length * direction_of(torch.tensor([a], dtype=torch.float64))
        return float(angle_error_deg(direction, torch.tensor([b], dtype=torch.float64)))

    reference = error(answered, true)
    assert abs(reference) <= 180.0 + 1e-9
    around = (answered - true + 180.0) % 360.0 - 180.0
    for other in (around, error(answered + turn, true + turn), -error(true, answered)):
        assert (other - reference + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=1e-6)


def test_multi_contact_loss_by_hand():
    output = MultiContactOutput(
        contact_logits=torch.tensor([[0.0, 0.0]]),
        magnitude_n=torch.tensor([[10.0, 1.0]]),
        magnitude_std_n=torch.tensor([[2.0, 7.0]]),
    )
    target = MultiContactTarget(torch.tensor([[1.0, 0.0]]), torch.tensor([[6.0, 0.0]]))
    terms = multi_contact_loss(output, target, torch.tensor([4.0, 2.0]))
    assert float(terms.contact) == pytest.approx(math.log(2.0))
    assert float(terms.magnitude) == pytest.approx((1.0 + 0.5) / 2.0)
    assert float(terms.direction) == 0.0
    assert float(terms.spread) == pytest.approx(0.5 * 4.0 + math.log(2.0))


@pytest.mark.parametrize("quantile", [0.025, 0.5, 0.975])
def test_the_pinball_is_least_where_so_many_values_lie_below(quantile):
    values = torch.linspace(0.0, 1.0, 1001) ** 2
    stated = torch.linspace(0.0, 1.0, 401)
    loss = pinball(values - stated[:, None], quantile).mean(1)
    assert float(stated[loss.argmin()]) == pytest.approx(quantile**2, abs=5e-3)
