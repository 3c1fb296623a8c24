"""The stated uncertainty: a small head beside the answers that cannot disturb them."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from cablesense_training.networks.layers import perceptron, tension_norm_n

_LOG_RANGE = (-9.0, 6.0)


class StatedSpread(nn.Module):
    """What every head for stated standard deviations has.

    Attributes:
        factor: (outputs,) set after training such that 95 % of held-out errors lie within 1.96
            standard deviations.
    """

    factor: Tensor

    def __init__(self, outputs: int) -> None:
        super().__init__()
        self.register_buffer("factor", torch.ones(outputs))


class Spread(StatedSpread):
    """Standard deviations (B, outputs) from the answering network's hidden features.

    The features arrive detached, so the likelihood that trains this head leaves the answers
    alone. The length of the tension difference joins them, because sensor noise makes directions
    of weak forces uncertain as its inverse. The likelihood alone does not make 95 % intervals
    hold where errors have heavy tails; `factor` does.
    """

    unit: Tensor

    def __init__(self, features: int, outputs: int, width: int = 48) -> None:
        super().__init__(outputs)
        self.hidden = perceptron(features + 1, (width, width))
        self.log_std = nn.Linear(width, outputs)
        self.register_buffer("unit", torch.ones(outputs))

    def forward(self, features: Tensor, tension_difference_n: Tensor) -> Tensor:
        """Standard deviations (B, outputs) from features (B, F) and tension differences (B, M)."""
        length = torch.log(tension_norm_n(tension_difference_n))
        hidden = self.hidden(torch.cat([features.detach(), length], dim=-1))
        log_std = self.log_std(hidden).clamp(*_LOG_RANGE)
        std: Tensor = torch.exp(log_std) * self.unit * self.factor
        return std
