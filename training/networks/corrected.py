"""The closed form, weighed and corrected by a small network: the estimators that CableSense ships.

Statics gives one candidate per segment with its information. Little remains to be learnt: how much
its evidence counts against "no contact", where many slack cables bend the estimate, and how wide
the error really is. Corrections are counted in standard deviations of the closed form and bounded,
so that an arm unlike the training data still gets an answer by statics.
"""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor, nn
from torch.nn import functional

from cablesense_sim.arm import Arm
from cablesense_training.errors import TrainingError
from cablesense_training.inference.history_simulation import depends_on_history, without_history
from cablesense_training.inference.metadata import HISTORY_SIMULATED
from cablesense_training.networks.closed_form import ClosedForm, inverse
from cablesense_training.networks.layers import (
    MultiContactOutput,
    SingleContactOutput,
    StatedSpread,
    perceptron,
)
from cablesense_training.networks.statics import StaticsNetwork, statics

LARGEST_CORRECTION = 1.0
"""In standard deviations of the closed form."""


class CorrectedClosedForm(StaticsNetwork):
    """Single contact from tension differences (B, M) and joint commands (B, 2N)."""

    def __init__(self, closed_form: ClosedForm, width: int = 48) -> None:
        super().__init__(closed_form)
        self.spread = StatedSpread(2)
        self.log_trust = nn.Parameter(torch.zeros(()))
        self.segment_bias = nn.Parameter(torch.zeros(self.segment_count))
        self.hidden = nn.Linear(self.cable_count, width)
        self.hidden_segment = nn.Parameter(0.1 * torch.randn(self.segment_count, width))
        self.heads = nn.Linear(width, 4, bias=False)
        nn.init.zeros_(self.heads.weight)
        self.double()

    def forward(
        self, tension_difference_n: Tensor, joint_command_rad: Tensor | None = None
    ) -> SingleContactOutput:
        """See the base class."""
        return self.answer_and_taut(tension_difference_n, joint_command_rad)[0]

    def answer_and_taut(
        self, tension_difference_n: Tensor, joint_command_rad: Tensor | None
    ) -> tuple[SingleContactOutput, Tensor]:
        """The answers, and (B, M) one for each taut cable and zero for each slack one."""
        balance = self.balance(tension_difference_n, joint_command_rad)
        candidates = self.closed_form.candidates(balance)
        evidence = candidates.log_evidence(torch.exp(self.log_trust)) + self.segment_bias
        found = candidates.likeliest(evidence)
        # the network sees which cables are taut, so its corrections only change when they do
        hidden = torch.tanh(self.hidden(balance.taut)[:, None] + self.hidden_segment)
        learnt = (found.chosen @ torch.tanh(self.heads(hidden)))[:, 0]
        shift, widen = learnt.chunk(2, dim=-1)

        shift_n = LARGEST_CORRECTION * shift * found.std_n
        force_n = found.force_n + (shift_n[:, None] @ found.axes)[:, 0]
        magnitude_n = torch.linalg.vector_norm(force_n, dim=-1)
        std_n, turned_n = (found.std_n * torch.exp(widen) * self.spread.factor).unbind(-1)
        output = SingleContactOutput(
            contact_logits=functional.pad(evidence, (1, 0)),
            direction=force_n / magnitude_n[:, None],
            magnitude_n=magnitude_n,
            magnitude_std_n=std_n,
            angle_std_deg=torch.rad2deg(turned_n / magnitude_n),
        )
        return output, balance.taut


def plain_closed_form(arm: Arm, tare_samples: int) -> CorrectedClosedForm:
    """The baseline: statics at the commanded pose; nothing in it is trained."""
    network = CorrectedClosedForm(statics(arm, tare_samples, exact=True, pose_corrections=0))
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


UNTOUCHED_PRECISION = 1e6
"""Information, 1/N², that an untouched segment's force is zero: it cannot exceed a millinewton."""

_FORCE_SCALE_N = 60.0
_WEAKEST_N = 1e-3


class MultiContactClosedForm(StaticsNetwork):
    """Which segments are touched, and how hard, for tension differences and commands.

    N segments with two force components each are 2N unknowns for 2N joint torques: solvable,
    without redundancy. A segment is touched where its force is too large for its own uncertainty.
    A second fit, over the touched segments alone, has redundancy again and is more precise.
    """

    several: ClassVar[bool] = True
    exact: ClassVar[bool] = True

    def __init__(self, closed_form: ClosedForm, width: int = 32) -> None:
        super().__init__(closed_form)
        segments = self.segment_count
        self.spread = StatedSpread(segments)
        self.trust = nn.Parameter(torch.full((segments,), 0.5))
        self.bias = nn.Parameter(torch.full((segments,), -6.0))
        self.widen = perceptron(2 * segments + self.cable_count, (width,))
        self.log_widen = nn.Linear(width, segments)
        nn.init.zeros_(self.log_widen.weight)
        nn.init.zeros_(self.log_widen.bias)
        self.double()

    def forward(
        self, tension_difference_n: Tensor, joint_command_rad: Tensor | None = None
    ) -> MultiContactOutput:
        """See the base class; the commanded angles are needed."""
        n = self.segment_count
        balance = self.balance(tension_difference_n, joint_command_rad)
        lever = self.closed_form.contact_levers(balance).reshape(-1, 2 * n, 2 * n)
        weighted = lever @ balance.precision
        information = weighted @ lever.transpose(1, 2)
        pull = weighted @ balance.torque_n_m[..., None]
        covariance = inverse(information)
        # chi² of each segment's own two components, the others unknown
        together = covariance @ pull
        own, pairs = _own_blocks(covariance, n), together.reshape(-1, n, 2, 1)
        significance = (pairs * (inverse(own) @ pairs)).sum((2, 3))
        logits = self.trust * significance + self.bias
        touched = (logits > 0.0).to(pull.dtype)
        held = ((1.0 - touched) * UNTOUCHED_PRECISION)[:, :, None].expand(-1, -1, 2)
        covariance = inverse(information + torch.diag_embed(held.reshape(-1, 2 * n)))
        force = (covariance @ pull).reshape(-1, n, 2)
        magnitude = torch.sqrt((force * force).sum(-1) + _WEAKEST_N**2)
        radial = (force / magnitude[..., None])[..., None]
        variance = (radial * (_own_blocks(covariance, n) @ radial)).sum((2, 3))
        std = torch.sqrt(variance.clamp(min=0.0) + 1e-6)
        features = [magnitude / _FORCE_SCALE_N, touched, balance.taut]
        hidden = self.widen(torch.cat(features, dim=-1).detach())
        scale = torch.exp(torch.tanh(self.log_widen(hidden)))
        return MultiContactOutput(logits, magnitude, std.detach() * scale * self.spread.factor)


def _own_blocks(matrix: Tensor, segments: int) -> Tensor:
    """The 2 by 2 blocks (B, N, 2, 2) on the diagonal of (B, 2N, 2N)."""
    blocks = matrix.reshape(-1, segments, 2, segments, 2)
    return torch.stack([blocks[:, s, :, s] for s in range(segments)], dim=1)
