"""The two-stage network follows equations (9) to (13)."""

import pytest
import torch

from cablesense_training.networks.layers import one_hot_of_argmax
from cablesense_training.networks.single_contact import TwoStageNetwork


@pytest.fixture
def network():
    torch.manual_seed(0)
    return TwoStageNetwork(12, 4, contact_widths=(16,), widths=(16, 8)).eval()


def test_one_hot_marks_the_likeliest_class_and_stops_gradients():
    logits = torch.tensor([[0.1, 3.0, -1.0], [5.0, 4.9, 4.8]], requires_grad=True)
    code = one_hot_of_argmax(logits)
    assert code.tolist() == [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]
    assert not code.requires_grad


def test_stage_two_sees_the_input_and_the_verdict_of_stage_one(network):
    x = torch.randn(6, 12)
    seen = []
    network.trunk.register_forward_hook(lambda _, inputs, __: seen.append(inputs[0]))
    output = network(x)
    torch.testing.assert_close(seen[0][:, :12], x)
    torch.testing.assert_close(seen[0][:, 12:], one_hot_of_argmax(output.contact_logits))


def test_another_verdict_changes_magnitude_and_direction(network):
    x = torch.randn(5, 12)
    with torch.no_grad():
        before = network(x)
        other = (before.contact_logits.argmax(-1) + 1) % 5
        network.contact_head.weight.zero_()
        network.contact_head.bias.zero_()
        network.contact_head.bias[int(other[0])] = 1.0
        after = network(x)
    assert not torch.equal(before.magnitude_n[0], after.magnitude_n[0])
    assert not torch.equal(before.direction[0], after.direction[0])


def test_stage_one_learns_from_the_contact_alone(network):
    output = network(torch.randn(4, 12))
    (output.magnitude_n.sum() + output.direction.sum()).backward()
    assert network.contact_head.weight.grad is None
    assert network.trunk[0].weight.grad is not None
