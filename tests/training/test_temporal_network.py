"""The history-dependent network: statics until trained, bounded corrections, stop operators."""

import math

import numpy as np
import pytest
import torch

from cablesense_sim.arm import open_arm
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.protocols import SingleContact
from cablesense_training.networks.temporal import (
    LARGEST_LOG_FACTOR,
    LARGEST_OFFSET,
    TemporalNetwork,
    Ticks,
)

CDSM = open_arm("cdsm")


@pytest.fixture
def network():
    torch.manual_seed(0)
    return TemporalNetwork.for_arm(CDSM).double().eval()


def _ticks(dataset):
    still = torch.zeros(len(dataset), CDSM.joint_count, dtype=torch.float64)
    difference = torch.as_tensor(dataset.tension_difference_n)
    return Ticks(difference, torch.as_tensor(dataset.command_rad), still, still)


def test_untrained_and_sure_of_the_torques_it_answers_by_statics(network):
    network.error.std.fill_(1e-6)
    protocol = SingleContact(samples=200, pose="random", noise=False, force_low_n=5.0)
    dataset = draw_dataset(CDSM, protocol)
    with torch.no_grad():
        output, *_ = network(_ticks(dataset), torch.zeros(200, network.memory).double())
    touched = dataset.segment > 0
    assert (output.contact_logits.argmax(-1).numpy() == dataset.segment)[touched].mean() > 0.98
    off = np.abs(output.magnitude_n.numpy() - dataset.magnitude_n)[touched]
    assert np.quantile(off, 0.9) < 0.05


def _answered_in_any_state(network):
    """Statics of 50 samples, and what the network makes of them in states far from any it knew."""
    dataset = draw_dataset(CDSM, SingleContact(samples=50, pose="random"))
    ticks = _ticks(dataset)
    with torch.no_grad():
        balance = network.balance(ticks)
        past = torch.zeros(50, network.drawn.past.size).double()
        encoded = network.encode(balance.torque_n_m, past, ticks)
        still = torch.zeros(50, CDSM.joint_count).double()
        answer = network.answer(balance, encoded, 100.0 * torch.randn(50, 96).double(), still)
    return balance, (answer.torque_n_m - balance.torque_n_m).abs()


def test_whatever_the_state_each_cable_is_corrected_by_a_bounded_amount(network):
    network.error.std.fill_(1e-9)
    network.tension.std.fill_(0.5)
    torch.nn.init.normal_(network.offset.weight, std=50.0)
    torch.nn.init.normal_(network.factor.weight, std=50.0)
    balance, moved_n_m = _answered_in_any_state(network)
    off_n = LARGEST_OFFSET * 0.5 + math.expm1(LARGEST_LOG_FACTOR) * balance.tension_n.abs()
    most_n_m = (balance.jacobian_t_m.abs() @ off_n[..., None])[..., 0]
    assert moved_n_m.max() > 0.01
    assert (moved_n_m <= most_n_m + 1e-6).all()


def _stated(network, none_logit):
    """Answers to pushes, as stated with about this logit of no contact, and their intervals."""
    network.interval.heads[-1].bias.data = torch.tensor([none_logit, 0.5, 0.5, 0.0]).double()
    ticks = _ticks(draw_dataset(CDSM, SingleContact(samples=50, pose="random")))
    with torch.no_grad():
        output, _, interval_n = network(ticks, torch.zeros(50, network.memory).double())
    return output, interval_n.unbind(-1)


def test_a_certain_contact_has_an_interval_around_its_force(network):
    output, (low_n, high_n) = _stated(network, -30.0)
    assert (output.contact_logits.argmax(-1) > 0).all()
    assert (low_n > 0.0).any()
    assert (low_n <= output.magnitude_n).all()
    assert (output.magnitude_n <= high_n)[low_n > 0.0].all()


def test_where_nothing_may_touch_the_interval_begins_at_nothing_and_says_what_may(network):
    _, (low_n, high_n) = _stated(network, 20.0)
    assert (low_n == 0.0).all()
    assert (high_n > 0.0).any()
