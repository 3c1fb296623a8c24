"""The closed form, weighed and corrected by a small network: the estimator that CableSense ships.

Statics gives one candidate per segment with its misfit and covariance. What is left to learn is little: how strongly
to believe a misfit, what speaks for "no contact", where many slack cables bend the estimate, and how wide the error
really is. Corrections are counted in standard deviations of the closed form and bounded, so that an arm unlike the
training data still gets an answer by statics.
"""

from __future__ import annotations

import math
from typing import ClassVar

import torch
from torch import Tensor, nn
from torch.nn import functional

from cablesense_sim.arm import Arm
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.sensors import difference_variance_n2
from cablesense_training.networks.layers import one_hot_of_argmax
from cablesense_training.networks.single_contact import Answer, SingleContactNetwork
from cablesense_training.networks.spread import Spread
from cablesense_training.physics.closed_form import Candidates, ClosedForm, pose_corrections_for

LARGEST_CORRECTION = 2.0
"""In standard deviations of the closed form."""

_FORCE_SCALE_N = 100.0
_WEAKEST_N = 1e-3


class CorrectedClosedForm(SingleContactNetwork):
    """Single-contact estimator for tension differences (B, M) and commanded joint angles (B, 2N); computes in float64.

    Args:
        mechanism: the arm.
        reading_variance_n2: variance of one tension difference, N².
        pose_corrections: Gauss-Newton steps of the closed form, see `ClosedForm`.
        force_range_n: largest force expected; the prior of a contact is uniform in angle and in magnitude up to it.
    """

    pose_aware: ClassVar[bool] = True
    quarter_turn: Tensor
    half_trace: Tensor

    def __init__(
        self,
        mechanism: Mechanism,
        reading_variance_n2: float,
        pose_corrections: int,
        force_range_n: float = 200.0,
        width: int = 64,
    ) -> None:
        segments, cables = mechanism.segment_count, mechanism.cable_count
        super().__init__(cables, segments, features=2)
        self.spread = ScaledSpread(width)
        self.closed_form = ClosedForm(mechanism, reading_variance_n2, pose_corrections)
        self.log_force_range = math.log(force_range_n)
        self.log_trust = nn.Parameter(torch.zeros(()))
        self.segment_bias = nn.Parameter(torch.zeros(segments))
        self.hidden = nn.Linear(3 + segments + cables, width)
        self.correction = _silent(width, 2)
        self.register_buffer("quarter_turn", torch.tensor([[0.0, -1.0], [1.0, 0.0]]))
        self.register_buffer("half_trace", 0.5 * torch.eye(2))
        self.double()

    @classmethod
    def for_arm(cls, arm: Arm, tare_samples: int = 50) -> CorrectedClosedForm:
        """The network of an arm, its sensors, and a tare averaged over `tare_samples` readings."""
        mechanism = Mechanism.from_arm(arm)
        variance = difference_variance_n2(arm.sensors, tare_samples)
        return cls(mechanism, variance, pose_corrections_for(mechanism))

    def adapt(self, tension_difference_n: Tensor, magnitude_n: Tensor) -> None:
        """Physics needs no scaling; only the loss does, and counts magnitudes in the sensors' own noise."""
        self.magnitude.std.fill_(self.closed_form.reading_variance_n2**0.5)

    def answer(self, tension_difference_n: Tensor, joint_command_rad: Tensor | None) -> Answer:
        """See the base class; features are the closed form's two standard deviations and the hidden layer."""
        assert joint_command_rad is not None
        found = self.closed_form(tension_difference_n.double(), joint_command_rad.double())
        evidence = self._evidence(found)
        chosen = one_hot_of_argmax(evidence)[:, None]
        force = chosen @ found.force_n
        covariance = (chosen @ found.covariance_n2.reshape(-1, self.segment_count, 4)).reshape(
            -1, 2, 2
        )
        strength = _length(force)
        radial = force / strength
        axes = torch.cat([radial, radial @ self.quarter_turn], dim=1)
        stds = torch.sqrt((axes @ covariance * axes).sum(-1))
        features = [radial, strength * (1.0 / _FORCE_SCALE_N), chosen, found.taut[:, None]]
        hidden = torch.tanh(self.hidden(torch.cat(features, dim=-1)[:, 0]))
        shift = LARGEST_CORRECTION * torch.tanh(self.correction(hidden))
        force = force + (shift * stds)[:, None] @ axes
        magnitude = _length(force)
        angle_std_deg = torch.rad2deg(stds[:, 1:] / magnitude[:, 0])
        return Answer(
            contact_logits=functional.pad(evidence, (1, 0)),
            direction=(force / magnitude)[:, 0],
            magnitude_n=magnitude[:, 0, 0],
            features=torch.cat([stds[:, :1], angle_std_deg, hidden], -1),
        )

    def _evidence(self, found: Candidates) -> Tensor:
        """Log evidence (B, N) against no contact: misfit explained, less the Occam factor of two free components.

        With prior density 1 / (2 pi F F_max) the evidence integral over f is v / (F F_max) at the best fit, v being
        the variance of a component (Laplace; MacKay, Information Theory, Inference, and Learning Algorithms, 2003,
        chapter 28).
        """
        variance = (found.covariance_n2 * self.half_trace).sum((2, 3))
        squared = (found.force_n * found.force_n).sum(-1) + variance
        occam = torch.log(variance * variance / squared)
        explained = torch.exp(self.log_trust) * found.explained
        return 0.5 * (explained + occam) + (self.segment_bias - self.log_force_range)


class PlainClosedForm(CorrectedClosedForm):
    """The peer to beat: statics at the commanded pose, as a data sheet would do it; nothing in it is trained."""

    @classmethod
    def for_arm(cls, arm: Arm, tare_samples: int = 50) -> PlainClosedForm:
        """The closed form of an arm that is taken to stand where it is commanded."""
        network = cls(
            Mechanism.from_arm(arm),
            difference_variance_n2(arm.sensors, tare_samples),
            pose_corrections=0,
        )
        network.requires_grad_(False)
        return network


class ScaledSpread(Spread):
    """The closed form's standard deviations, widened or narrowed by what the hidden layer knows."""

    def __init__(self, width: int) -> None:
        super().__init__(features=2, outputs=2, width=2)
        del self.hidden, self.log_std  # layers of the base class that have no part here
        self.log_scale = _silent(width, 2)

    def forward(self, features: Tensor, tension_difference_n: Tensor) -> Tensor:
        """Standard deviations (N, degrees) from the first two features; the rest is the hidden layer."""
        known = features.detach()
        scale = torch.exp(torch.tanh(self.log_scale(known[:, 2:])))
        return known[:, :2] * scale * self.factor


def _silent(inputs: int, outputs: int) -> nn.Linear:
    """A layer that says nothing until it is trained."""
    layer = nn.Linear(inputs, outputs)
    nn.init.zeros_(layer.weight)
    nn.init.zeros_(layer.bias)
    return layer


def _length(force: Tensor) -> Tensor:
    """Length (B, 1, 1) of forces (B, 1, 2), kept off zero."""
    return torch.sqrt((force * force).sum(-1, keepdim=True) + _WEAKEST_N**2)
