"""Standardisation there and back."""

import torch

from cablesense_training.networks.layers import Standardiser


def test_adapted_rows_have_mean_zero_and_deviation_one():
    generator = torch.Generator().manual_seed(3)
    values = torch.randn(500, 3, generator=generator) * torch.tensor([0.1, 5.0, 200.0]) + 40.0
    scaling = Standardiser(3)
    scaling.adapt(values)
    scaled = scaling(values)
    torch.testing.assert_close(scaled.mean(0), torch.zeros(3), atol=1e-3, rtol=0.0)
    torch.testing.assert_close(scaled.std(0, correction=0), torch.ones(3), atol=1e-3, rtol=0.0)
    torch.testing.assert_close(scaling.undo(scaled), values, atol=1e-3, rtol=0.0)


def test_a_constant_column_stays_finite():
    scaling = Standardiser(1)
    scaling.adapt(torch.full((10, 1), 7.0))
    torch.testing.assert_close(scaling(torch.tensor([[8.0]])), torch.tensor([[1.0]]))


def test_scaling_is_saved_with_the_weights():
    scaling = Standardiser(2)
    scaling.adapt(torch.tensor([[1.0, 2.0], [3.0, 6.0]]))
    other = Standardiser(2)
    other.load_state_dict(scaling.state_dict())
    torch.testing.assert_close(other.mean, torch.tensor([2.0, 4.0]))
    torch.testing.assert_close(other.std, torch.tensor([1.0, 2.0]))
