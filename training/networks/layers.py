"""Building blocks that the networks share."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn


def perceptron(inputs: int, widths: Sequence[int]) -> nn.Sequential:
    """Fully connected hidden layers of the given widths, each followed by a SiLU."""
    layers: list[nn.Module] = []
    for width in widths:
        layers += [nn.Linear(inputs, width), nn.SiLU()]
        inputs = width
    return nn.Sequential(*layers)


def one_hot_of_argmax(logits: Tensor) -> Tensor:
    """One-hot code (B, K) of the likeliest class, equation (10); no gradient passes through it."""
    winner = logits.argmax(dim=-1, keepdim=True)
    classes = torch.arange(logits.shape[-1], device=logits.device)
    return (classes == winner).to(logits.dtype)


def tension_norm_n(tension_difference_n: Tensor) -> Tensor:
    """Length (B, 1) of the tension differences, kept off zero by 1 mN, so safe to divide by."""
    squared = (tension_difference_n * tension_difference_n).sum(dim=-1, keepdim=True)
    return torch.sqrt(squared + 1e-6)
