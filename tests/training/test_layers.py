"""Layers that the networks share."""

import pytest
import torch

from cablesense_training.networks.layers import GatedLayer, gated_perceptron, tension_norm_n


def test_a_gated_layer_can_multiply_its_inputs():
    layer = GatedLayer(2, 1)
    with torch.no_grad():
        # silu(x) is close to x for large x, so a gate on the first input times the second
        layer.gate.weight.copy_(torch.tensor([[1.0, 0.0]]))
        layer.value.weight.copy_(torch.tensor([[0.0, 1.0]]))
        layer.gate.bias.zero_()
        layer.value.bias.zero_()
        found = layer(torch.tensor([[30.0, 7.0], [40.0, -2.0]]))
    assert found[:, 0].tolist() == pytest.approx([210.0, -80.0])


def test_gated_layers_are_as_wide_as_asked():
    layers = gated_perceptron(5, (7, 3))
    assert layers(torch.zeros(2, 5)).shape == (2, 3)
    assert layers[0](torch.zeros(2, 5)).shape == (2, 7)


def test_the_length_of_nothing_is_a_millinewton():
    lengths = tension_norm_n(torch.tensor([[3.0, 4.0], [0.0, 0.0]]))
    assert lengths[:, 0].tolist() == pytest.approx([5.0, 1e-3])
