"""The closed form, weighed and corrected by a small network: the estimator that CableSense ships.

Statics gives one candidate per segment with its misfit and covariance. What is left to learn is little: how strongly
to believe a misfit, what speaks for "no contact", where many slack cables bend the estimate, and how wide the error
really is. Corrections are counted in standard deviations of the closed form and bounded, so that an arm unlike the
training data still gets an answer by statics.
"""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor, nn

from cablesense_sim.mechanism import Mechanism
from cablesense_training.networks.layers import one_hot_of_argmax, perceptron
from cablesense_training.networks.single_contact import Answer, SingleContactNetwork
from cablesense_training.networks.spread import Spread
from cablesense_training.physics.closed_form import Candidates, ClosedForm

LARGEST_CORRECTION = 3.0
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

    def __init__(
        self,
        mechanism: Mechanism,
        reading_variance_n2: float,
        pose_corrections: int,
        force_range_n: float = 200.0,
        widths: tuple[int, ...] = (32, 32),
    ) -> None:
        segments, cables = mechanism.segment_count, mechanism.cable_count
        super().__init__(cables, segments, features=2)
        self.spread = ScaledSpread(widths[-1])
        self.closed_form = ClosedForm(mechanism, reading_variance_n2, pose_corrections)
        self.force_range_n = force_range_n
        self.log_trust = nn.Parameter(torch.zeros(()))
        self.segment_bias = nn.Parameter(torch.zeros(segments))
        self.hidden = perceptron(3 + segments + cables, widths)
        self.correction = _silent(widths[-1], 2)
        self.double()

    def adapt(self, tension_difference_n: Tensor, magnitude_n: Tensor) -> None:
        """Physics needs no scaling; only the loss does, and counts magnitudes in the sensors' own noise."""
        self.magnitude.std.fill_(self.closed_form.reading_variance_n2**0.5)

    def answer(self, tension_difference_n: Tensor, joint_command_rad: Tensor | None) -> Answer:
        """See the base class; features are the closed form's two standard deviations and the hidden layer."""
        assert joint_command_rad is not None
        found = self.closed_form(tension_difference_n.double(), joint_command_rad.double())
        contact_logits = self._contact_logits(found)
        chosen = one_hot_of_argmax(contact_logits[:, 1:])
        force = (found.force_n * chosen[..., None]).sum(1)
        covariance = (found.covariance_n2 * chosen[..., None, None]).sum(1)
        strength = _norm(force)
        radial = force / strength[:, None]
        tangential = torch.stack([radial[:, 1], -radial[:, 0]], -1)
        radial_std = _std_along(radial, covariance)
        angular_std = _std_along(tangential, covariance)
        hidden = self.hidden(_features(force, strength, chosen, found.tensions_n))
        shift = LARGEST_CORRECTION * torch.tanh(self.correction(hidden) / LARGEST_CORRECTION)
        force = force + (shift[:, :1] * radial_std[:, None]) * radial
        force = force + (shift[:, 1:] * angular_std[:, None]) * tangential
        magnitude = _norm(force)
        angle_std_deg = torch.rad2deg(angular_std / magnitude)
        stds = torch.stack([radial_std, angle_std_deg], -1)
        return Answer(
            contact_logits=contact_logits,
            direction=force / magnitude[:, None],
            magnitude_n=magnitude,
            features=torch.cat([stds, hidden], -1),
        )

    def _contact_logits(self, found: Candidates) -> Tensor:
        """Log evidence against no contact: misfit saved, less the Occam factor of two free components.

        With prior density 1 / (2 pi F F_max) the evidence integral over f is sqrt(det C) / (F F_max) at the best fit
        (Laplace; MacKay, Information Theory, Inference, and Learning Algorithms, 2003, chapter 28).
        """
        covariance_det = _determinant(found.covariance_n2).clamp(min=1e-30)
        saved = 0.5 * (found.misfit_none[:, None] - found.misfit)
        weak = torch.sqrt((found.force_n**2).sum(-1) + torch.sqrt(covariance_det))
        occam = 0.5 * torch.log(covariance_det) - torch.log(weak * self.force_range_n)
        evidence = torch.exp(self.log_trust) * saved + occam + self.segment_bias
        return torch.cat([torch.zeros_like(evidence[:, :1]), evidence], dim=-1)


class ScaledSpread(Spread):
    """The closed form's standard deviations, widened or narrowed by what the hidden layer knows."""

    def __init__(self, width: int) -> None:
        super().__init__(features=2, outputs=2, width=2)
        self.log_scale = _silent(width, 2)

    def forward(self, features: Tensor, tension_difference_n: Tensor) -> Tensor:
        """Standard deviations (N, degrees) from the first two features; the rest is the hidden layer."""
        known = features.detach()
        scale = torch.exp(2.0 * torch.tanh(self.log_scale(known[:, 2:])))
        return known[:, :2] * scale * self.factor


def _silent(inputs: int, outputs: int) -> nn.Linear:
    """A layer that says nothing until it is trained."""
    layer = nn.Linear(inputs, outputs)
    nn.init.zeros_(layer.weight)
    nn.init.zeros_(layer.bias)
    return layer


def _features(force: Tensor, strength: Tensor, chosen: Tensor, tensions_n: Tensor) -> Tensor:
    level = torch.log(strength / _FORCE_SCALE_N)[:, None] / 5.0
    scaled = torch.tanh(tensions_n / _FORCE_SCALE_N)
    return torch.cat([force / _FORCE_SCALE_N, level, chosen, scaled], dim=-1)


def _norm(force: Tensor) -> Tensor:
    return torch.sqrt((force**2).sum(-1) + _WEAKEST_N**2)


def _determinant(matrix: Tensor) -> Tensor:
    return matrix[..., 0, 0] * matrix[..., 1, 1] - matrix[..., 0, 1] * matrix[..., 1, 0]


def _std_along(direction: Tensor, covariance: Tensor) -> Tensor:
    variance = (direction[:, None, :] @ covariance @ direction[:, :, None])[:, 0, 0]
    return torch.sqrt(variance.clamp(min=1e-18))
