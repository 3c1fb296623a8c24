"""Several contacts at once, read from the forces that statics gives."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn

from cablesense_sim.arm import Arm
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.sensors import difference_variance_n2
from cablesense_training.networks.layers import perceptron
from cablesense_training.networks.multi_contact import MultiAnswer, MultiContactNetwork
from cablesense_training.physics.straight_forces import straight_force_matrix

_TARE_SAMPLES = 50
_LEAST_STD_N = 1e-6


class StaticsMultiContactNetwork(MultiContactNetwork):
    """The two stages behind the straight arm's statics, counted in standard deviations of the noise.

    A weak force on one segment is a small difference of large tensions when another segment is pushed hard, which a
    network on the raw tensions resolves poorly. Here stage one sees the logarithm of every segment's force over its
    noise, and stage two corrects the force that statics gives by a factor.

    Args:
        mechanism: the arm.
        reading_variance_n2: variance of one tension difference, N².
    """

    force_matrix: Tensor
    noise_std_n: Tensor

    def __init__(
        self,
        mechanism: Mechanism,
        reading_variance_n2: float,
        contact_widths: Sequence[int] = (64, 64),
        widths: Sequence[int] = (64, 64),
    ) -> None:
        segments, cables = mechanism.segment_count, mechanism.cable_count
        super().__init__(cables, segments, features=widths[-1])
        matrix = straight_force_matrix(mechanism)
        variance = reading_variance_n2 * (matrix**2).sum(axis=1).reshape(segments, 2).sum(axis=1)
        noise = np.maximum(np.sqrt(variance), _LEAST_STD_N)
        self.register_buffer("force_matrix", torch.as_tensor(matrix.T, dtype=torch.float32))
        self.register_buffer("noise_std_n", torch.as_tensor(noise, dtype=torch.float32))
        inputs = segments + cables
        self.contact_trunk = perceptron(inputs, contact_widths)
        self.contact_head = nn.Linear(contact_widths[-1], segments)
        self.trunk = perceptron(inputs + segments, widths)
        self.factor_head = nn.Linear(widths[-1], segments)
        nn.init.zeros_(self.factor_head.weight)
        nn.init.zeros_(self.factor_head.bias)

    @classmethod
    def for_arm(cls, arm: Arm) -> StaticsMultiContactNetwork:
        """The network of an arm and its sensors."""
        mechanism = Mechanism.from_arm(arm)
        return cls(mechanism, difference_variance_n2(arm.sensors, _TARE_SAMPLES))

    def answer(self, tension_difference_n: Tensor) -> MultiAnswer:
        """See the base class."""
        force = (tension_difference_n @ self.force_matrix).unflatten(-1, (self.segment_count, 2))
        size = torch.sqrt((force * force).sum(dim=-1) + self.noise_std_n**2)
        level = torch.log(size / self.noise_std_n)
        x = torch.cat([level, self.tension(tension_difference_n)], dim=-1)
        logits = self.contact_head(self.contact_trunk(x))
        touched = (logits > 0.0).to(x.dtype)
        hidden = self.trunk(torch.cat([x, touched], dim=-1))
        factor = torch.exp(self.factor_head(hidden).clamp(max=3.0))
        return MultiAnswer(logits, size * factor, hidden)
