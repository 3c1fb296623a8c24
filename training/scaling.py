"""Standardisation of inputs and labels, inside the networks: they take and give physical units."""

from __future__ import annotations

import torch
from torch import Tensor, nn

SMALLEST_STD = 1e-9
"""A column that never varies is left unscaled instead of being divided by its rounding error."""


class Standardiser(nn.Module):
    """`(x - mean) / std` per column, and back; `adapt` sets these buffers from training data.

    Before `adapt` it changes nothing.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, columns: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(columns))
        self.register_buffer("std", torch.ones(columns))

    def adapt(self, values: Tensor) -> None:
        """Take mean and standard deviation from rows (B, columns)."""
        std = values.std(dim=0, correction=0)
        self.mean.copy_(values.mean(dim=0))
        self.std.copy_(torch.where(std > SMALLEST_STD, std, torch.ones_like(std)))

    def forward(self, values: Tensor) -> Tensor:
        """Standardised rows (B, columns)."""
        scaled: Tensor = (values - self.mean) / self.std
        return scaled

    def undo(self, values: Tensor) -> Tensor:
        """Rows in physical units from standardised ones."""
        physical: Tensor = values * self.std + self.mean
        return physical
