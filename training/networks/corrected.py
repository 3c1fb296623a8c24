"""The closed form, weighed and corrected by a small network: the estimators that CableSense ships.

Statics gives one candidate per segment with its information. Little remains to be learnt: how much
its evidence counts against "no contact", where many slack cables bend the estimate, and how wide
the error really is. Corrections are counted in standard deviations of the closed form and bounded,
so that an arm unlike the training data still gets an answer by statics.
"""

from __future__ import annotations

import math
from typing import ClassVar

import torch
from torch import Tensor, nn
from torch.nn import functional

from cablesense_sim.arm import Arm
from cablesense_training.errors import TrainingError
from cablesense_training.inference.history_simulation import depends_on_history, without_history
from cablesense_training.inference.metadata import HISTORY_SIMULATED
from cablesense_training.networks.closed_form import Candidates, ClosedForm, inverse, own_blocks
from cablesense_training.networks.layers import (
    ContactNetwork,
    MultiContactOutput,
    SingleContactOutput,
    StatedSpread,
    one_hot_of_argmax,
    perceptron,
)
from cablesense_training.networks.second_order import SecondOrderClosedForm
from cablesense_training.networks.statics import exact_statics, statics, unreading

LOG_PRIOR = -2.0 * math.log(200.0)
"""Of a contact: uniform over the disc of forces up to 200 N, but for pi."""

LARGEST_CORRECTION = 1.0
"""In standard deviations of the closed form."""


class CorrectedClosedForm(ContactNetwork):
    """Single contact from tension differences (B, M) and joint commands (B, 2N), in float64.

    Args:
        arm: the arm.
        closed_form: its statics.

    Attributes:
        unread: (M, M) of `unreading`; none where readings are tensions.
    """

    pose_aware: ClassVar[bool] = True
    frame: Tensor
    unread: Tensor | None

    def __init__(self, arm: Arm, closed_form: ClosedForm | SecondOrderClosedForm) -> None:
        segments, width = arm.segment_count, 48
        super().__init__(arm.cable_count, segments)
        self.closed_form = closed_form
        self.spread = StatedSpread(2)
        self.log_trust = nn.Parameter(torch.zeros(()))
        self.segment_bias = nn.Parameter(torch.zeros(segments))
        self.hidden = nn.Linear(arm.cable_count, width)
        self.hidden_segment = nn.Parameter(0.1 * torch.randn(segments, width))
        self.heads = nn.Linear(width, 4, bias=False)
        nn.init.zeros_(self.heads.weight)
        along_and_across = [[1.0, 0.0, 0.0, 1.0], [0.0, 1.0, -1.0, 0.0]]
        self.register_buffer("frame", torch.tensor(along_and_across))
        unread = unreading(arm)
        self.register_buffer("unread", None if unread is None else torch.as_tensor(unread))
        self.double()

    @classmethod
    def for_arm(cls, arm: Arm, tare_samples: int = 50) -> CorrectedClosedForm:
        """The network of an arm, its sensors, and a tare averaged over `tare_samples` readings."""
        return cls(arm, statics(arm, tare_samples))

    def adapt(self, tension_difference_n: Tensor, magnitude_n: Tensor) -> None:
        """Only the loss needs a scale, and counts magnitudes in the sensors' own noise."""
        self.magnitude.std.fill_(self.closed_form.reading_variance_n2**0.5)

    def forward(
        self, tension_difference_n: Tensor, joint_command_rad: Tensor | None = None
    ) -> SingleContactOutput:
        """See the base class."""
        return self.answer_and_taut(tension_difference_n, joint_command_rad)[0]

    def answer_and_taut(
        self, tension_difference_n: Tensor, joint_command_rad: Tensor | None
    ) -> tuple[SingleContactOutput, Tensor]:
        """The answers, and (B, M) one for each taut cable and zero for each slack one."""
        assert joint_command_rad is not None
        difference_n = tension_difference_n.double()
        if self.unread is not None:
            difference_n = difference_n @ self.unread
        found = self.closed_form.weigh(difference_n, joint_command_rad.double(), self._weighing)
        chosen = one_hot_of_argmax(found.evidence)
        force = chosen @ found.force_n
        root, shift, widen = (chosen @ self._known(found)).split([4, 2, 2], dim=-1)

        axes = (force / _length(force) @ self.frame).reshape(-1, 2, 2)
        stds = _length(axes @ root.reshape(-1, 2, 2)).transpose(1, 2)
        force = force + shift * stds @ axes
        magnitude = _length(force)
        std_n, turned_n = (stds * widen).chunk(2, dim=-1)
        output = SingleContactOutput(
            contact_logits=functional.pad(found.evidence, (1, 0)).flatten(1),
            direction=(force / magnitude).flatten(1),
            magnitude_n=magnitude.flatten(),
            magnitude_std_n=std_n.flatten(),
            angle_std_deg=(turned_n / magnitude).flatten(),
        )
        return output, found.taut

    def _known(self, found: Candidates) -> Tensor:
        """(B, N, 8) per segment: root of the covariance, correction, and widening of the spread.

        The network sees which cables are taut, so all this changes only when they do.
        """
        hidden = torch.tanh(self.hidden(found.taut)[:, None] + self.hidden_segment)
        shift, widen = torch.tanh(self.heads(hidden)).chunk(2, dim=-1)
        root = _square_root(found.covariance_n2).flatten(2)
        scale = self.spread.factor * self.spread.factor.new_tensor([1.0, 180.0 / math.pi])
        return torch.cat([root, LARGEST_CORRECTION * shift, torch.exp(widen) * scale], dim=-1)

    def _weighing(self, information: Tensor, covariance_n2: Tensor) -> tuple[Tensor, Tensor]:
        """Log evidence against no contact, as f' W f plus a constant.

        Half the explained misfit, minus the Occam factor of two free components: with a prior
        density of 1 / (pi F_max²), the evidence integral over f is 2 sqrt(det C) / F_max² at the
        best fit (Laplace; MacKay, Information Theory, Inference, and Learning Algorithms, 2003,
        chapter 28).
        """
        occam = 0.5 * torch.log(_determinant(covariance_n2)) + math.log(2.0) + LOG_PRIOR
        trust = 0.5 * torch.exp(self.log_trust)
        return information * trust, occam + self.segment_bias


def plain_closed_form(arm: Arm, tare_samples: int) -> CorrectedClosedForm:
    """The baseline: statics at the commanded pose; nothing in it is trained."""
    network = CorrectedClosedForm(arm, exact_statics(arm, tare_samples, pose_corrections=0))
    return network.requires_grad_(False)


def closed_form_without_history(arm: Arm, tare_samples: int) -> CorrectedClosedForm:
    """For what `inference.history_simulation` leaves of an arm's readings; trained as any other.

    Raises:
        TrainingError: nothing in the arm file depends on history.
    """
    if not depends_on_history(arm):
        raise TrainingError(
            f"network {HISTORY_SIMULATED} is for an arm file that lists friction, creep, "
            f"backlash or lagging sensors; {arm.identity} does not"
        )
    return CorrectedClosedForm.for_arm(without_history(arm), tare_samples)


def _length(rows: Tensor) -> Tensor:
    """Lengths (..., 1) of the last axis."""
    return torch.linalg.vector_norm(rows, dim=-1, keepdim=True)


def _determinant(matrix: Tensor) -> Tensor:
    return matrix[..., 0, 0] * matrix[..., 1, 1] - matrix[..., 0, 1] * matrix[..., 1, 0]


def _square_root(matrix: Tensor) -> Tensor:
    """Symmetric square roots of symmetric positive definite 2 by 2 matrices (..., 2, 2).

    `(A + sqrt(det A) I) / sqrt(tr A + 2 sqrt(det A))`, by Cayley and Hamilton.
    """
    root_det = torch.sqrt(_determinant(matrix))[..., None, None]
    trace = (matrix[..., 0, 0] + matrix[..., 1, 1])[..., None, None]
    identity = torch.eye(2, dtype=matrix.dtype)
    return (matrix + root_det * identity) / torch.sqrt(trace + 2.0 * root_det)


UNTOUCHED_PRECISION = 1e6
"""Information, 1/N², that an untouched segment's force is zero: it cannot exceed a millinewton."""

_FORCE_SCALE_N = 60.0
_WEAKEST_N = 1e-3


class MultiContactClosedForm(ContactNetwork):
    """Which segments are touched, and how hard, for tension differences and commands, float64.

    N segments with two force components each are 2N unknowns for 2N joint torques: solvable,
    without redundancy. A segment is touched where its force is too large for its own uncertainty.
    A second fit, over the touched segments alone, has redundancy again and is more precise.

    Args:
        closed_form: statics of the arm.
    """

    several: ClassVar[bool] = True
    pose_aware: ClassVar[bool] = True

    def __init__(self, closed_form: ClosedForm, width: int = 32) -> None:
        cables = closed_form.kinematics.cable_count
        segments = closed_form.kinematics.segment_count
        super().__init__(cables, segments)
        self.spread = StatedSpread(segments)
        self.closed_form = closed_form
        self.trust = nn.Parameter(torch.full((segments,), 0.5))
        self.bias = nn.Parameter(torch.full((segments,), -6.0))
        self.widen = perceptron(2 * segments + cables, (width,))
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
        # chi² of each segment's own two components, the others unknown
        together = covariance @ pull
        own, pairs = own_blocks(covariance, n), together.reshape(-1, n, 2, 1)
        significance = (pairs * (inverse(own) @ pairs)).sum((2, 3))
        logits = self.trust * significance + self.bias
        touched = (logits > 0.0).to(pull.dtype)
        held = ((1.0 - touched) * UNTOUCHED_PRECISION)[:, :, None].expand(-1, -1, 2)
        covariance = inverse(information + torch.diag_embed(held.reshape(-1, 2 * n)))
        force = (covariance @ pull).reshape(-1, n, 2)
        magnitude = torch.sqrt((force * force).sum(-1) + _WEAKEST_N**2)
        radial = (force / magnitude[..., None])[..., None]
        variance = (radial * (own_blocks(covariance, n) @ radial)).sum((2, 3))
        std = torch.sqrt(variance.clamp(min=0.0) + 1e-6)
        features = [magnitude / _FORCE_SCALE_N, touched, balance.taut]
        hidden = self.widen(torch.cat(features, dim=-1).detach())
        scale = torch.exp(torch.tanh(self.log_widen(hidden)))
        return MultiContactOutput(logits, magnitude, std.detach() * scale * self.spread.factor)
