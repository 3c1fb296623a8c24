"""Several contacts at once by statics: all segments' forces in one fit, then of those touched.

N segments with two force components each are 2N unknowns for 2N joint torques: solvable, without
redundancy. A segment is touched where its force is too large for its own uncertainty. Leaving the
untouched ones out gives the redundancy back, so the second fit, over the touched segments alone,
tells their forces better.
"""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor, nn

from cablesense_sim.arm import Arm
from cablesense_training.networks.layers import perceptron
from cablesense_training.networks.multi_contact import MultiContactNetwork
from cablesense_training.networks.output import MultiContactOutput
from cablesense_training.networks.spread import StatedSpread
from cablesense_training.physics.arm_statics import exact_statics
from cablesense_training.physics.closed_form import ClosedForm, inverse

UNTOUCHED_PRECISION = 1e6
"""Information, 1/N², that an untouched segment's force is zero: it cannot exceed a millinewton."""

_FORCE_SCALE_N = 60.0
_WEAKEST_N = 1e-3


class MultiContactClosedForm(MultiContactNetwork):
    """Contacts and magnitudes for tension differences (B, M) and joint commands (B, 2N), float64.

    Args:
        closed_form: statics of the arm.
    """

    pose_aware: ClassVar[bool] = True

    def __init__(
        self,
        closed_form: ClosedForm,
        width: int = 32,
    ) -> None:
        segments = closed_form.kinematics.segment_count
        super().__init__(closed_form.kinematics.cable_count, segments)
        self.spread = StatedSpread(segments)
        self.closed_form = closed_form
        self.trust = nn.Parameter(torch.full((segments,), 0.5))
        self.bias = nn.Parameter(torch.full((segments,), -6.0))
        self.widen = perceptron(2 * segments + closed_form.kinematics.cable_count, (width,))
        self.log_widen = nn.Linear(width, segments)
        nn.init.zeros_(self.log_widen.weight)
        nn.init.zeros_(self.log_widen.bias)
        self.double()

    @classmethod
    def for_arm(cls, arm: Arm, tare_samples: int = 50) -> MultiContactClosedForm:
        """The network of an arm, its sensors, and a tare averaged over `tare_samples` readings."""
        return cls(exact_statics(arm, tare_samples))

    def adapt(self, tension_difference_n: Tensor, magnitude_n: Tensor) -> None:
        """Only the loss needs a scale, and counts magnitudes in the sensors' own noise."""
        self.magnitude.std.fill_(self.closed_form.reading_variance_n2**0.5)

    def forward(
        self, tension_difference_n: Tensor, joint_command_rad: Tensor | None = None
    ) -> MultiContactOutput:
        """See the base class; the commanded angles are needed."""
        assert joint_command_rad is not None
        n = self.segment_count
        balance = self.closed_form.balance(
            tension_difference_n.double(), joint_command_rad.double()
        )
        lever = balance.lever.reshape(-1, 2 * n, 2 * n)
        weighted = lever @ balance.precision
        information = weighted @ lever.transpose(1, 2)
        pull = weighted @ balance.torque_n_m
        covariance = inverse(information)
        significance = _own_chi2(covariance @ pull, covariance, n)
        logits = self.trust * significance + self.bias
        touched = (logits > 0.0).to(pull.dtype)
        held = ((1.0 - touched) * UNTOUCHED_PRECISION)[:, :, None].expand(-1, -1, 2)
        covariance = inverse(information + torch.diag_embed(held.reshape(-1, 2 * n)))
        force = (covariance @ pull).reshape(-1, n, 2)
        magnitude = torch.sqrt((force * force).sum(-1) + _WEAKEST_N**2)
        std = _radial_std(force, magnitude, covariance)
        features = [magnitude / _FORCE_SCALE_N, touched, balance.taut]
        hidden = self.widen(torch.cat(features, dim=-1).detach())
        scale = torch.exp(torch.tanh(self.log_widen(hidden)))
        return MultiContactOutput(logits, magnitude, std.detach() * scale * self.spread.factor)


def _own_chi2(force: Tensor, covariance: Tensor, segments: int) -> Tensor:
    """(B, N) f' C^-1 f of each segment's own two components, the others unknown."""
    own = _own_blocks(covariance, segments)
    pairs = force.reshape(-1, segments, 2, 1)
    return (pairs * (inverse(own) @ pairs)).sum((2, 3))


def _own_blocks(covariance: Tensor, segments: int) -> Tensor:
    """The 2 by 2 blocks (B, N, 2, 2) on the diagonal."""
    blocks = covariance.reshape(-1, segments, 2, segments, 2)
    return torch.stack([blocks[:, s, :, s] for s in range(segments)], dim=1)


def _radial_std(force: Tensor, magnitude: Tensor, covariance: Tensor) -> Tensor:
    """(B, N) standard deviation of each force along itself, at least a millinewton."""
    radial = (force / magnitude[..., None])[..., None]
    own = _own_blocks(covariance, force.shape[1])
    variance = (radial * (own @ radial)).sum((2, 3))
    return torch.sqrt(variance.clamp(min=0.0) + 1e-6)
