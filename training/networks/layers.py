"""Building blocks that the networks share."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional


def perceptron(inputs: int, widths: Sequence[int]) -> nn.Sequential:
    """Fully connected hidden layers of the given widths, each followed by a SiLU."""
    layers: list[nn.Module] = []
    for width in widths:
        layers += [nn.Linear(inputs, width), nn.SiLU()]
        inputs = width
    return nn.Sequential(*layers)


class GatedLayer(nn.Module):
    """SiLU(W x + a) times (V x + b), elementwise: a layer that can multiply its inputs.

    What an unknown pose does to the tensions is a product of angles and forces, which a plain
    layer has to piece together. Shazeer, GLU Variants Improve Transformer, 2020 (there: SwiGLU).
    """

    def __init__(self, inputs: int, width: int) -> None:
        super().__init__()
        self.gate = nn.Linear(inputs, width)
        self.value = nn.Linear(inputs, width)

    def forward(self, x: Tensor) -> Tensor:
        """Features (B, width) of inputs (B, inputs)."""
        return functional.silu(self.gate(x)) * self.value(x)


def gated_perceptron(inputs: int, widths: Sequence[int]) -> nn.Sequential:
    """Gated hidden layers of the given widths."""
    pairs = zip([inputs, *widths], widths, strict=False)
    return nn.Sequential(*(GatedLayer(before, width) for before, width in pairs))


def one_hot_of_argmax(logits: Tensor) -> Tensor:
    """One-hot code (B, K) of the likeliest class, equation (10); no gradient passes through it."""
    winner = logits.argmax(dim=-1, keepdim=True)
    classes = torch.arange(logits.shape[-1], device=logits.device)
    return (classes == winner).to(logits.dtype)


def tension_norm_n(tension_difference_n: Tensor) -> Tensor:
    """Length (B, 1) of the tension differences, kept off zero by 1 mN, so safe to divide by."""
    squared = (tension_difference_n * tension_difference_n).sum(dim=-1, keepdim=True)
    return torch.sqrt(squared + 1e-6)
