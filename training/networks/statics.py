"""Networks on the closed form of an arm: the estimators that CableSense ships.

Statics gives one candidate per segment with its information. Little remains to be learnt: how much
its evidence counts against "no contact", where many slack cables bend the estimate, and how wide
the error really is. Corrections are bounded, so that an arm unlike the training data still gets an
answer by statics.

The closed form contains the effects on the arm itself: masses, stiffness, holes, springs, contact
points, while the actuators hold the lengths of the arm without them. `unreading` undoes what
sensors make of tensions at rest. Effects of history and of actuators count as spread.
"""

from __future__ import annotations

from typing import ClassVar, Self

import numpy as np
import torch
from torch import Tensor, nn

from cablesense_base import Array
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.effects.registry import actuations, amended, sensings, transmissions
from cablesense_sim.equilibrium import held_lengths_m, solve_equilibrium
from cablesense_sim.load_capacity import contact_range_n
from cablesense_sim.replay import difference_variance_n2
from cablesense_training.data.generation import draw_dataset, sensed_along_n
from cablesense_training.data.protocols import SingleContact, protocol_from_options
from cablesense_training.networks.closed_form import (
    Balance,
    ClosedForm,
    NearCommand,
    inverse,
    pose_corrections_for,
)
from cablesense_training.networks.layers import (
    ContactNetwork,
    MultiContactOutput,
    SingleContactOutput,
    StatedSpread,
    contact_of,
    perceptron,
)

LARGEST_CORRECTION = 1.0
"""In standard deviations of the closed form."""

_JUDGED_SAMPLES, _BORNE_BENT = 256, 0.5
"""How many contacts spread is judged on, and up to which share of what the straight arm bears."""
_LEAST_CORRECTIONS = 2
"""Residuals of a stiff arm's cable lengths need one more than its torques."""

_UNTOUCHED_PRECISION = 1e6
"""Information, 1/N², that an untouched segment's force is zero: it cannot exceed a millinewton."""
_FORCE_SCALE_N = 60.0
_WEAKEST_N = 1e-3


def statics(
    arm: Arm,
    tare_samples: int,
    *,
    exact: bool = False,
    pose_corrections: int | None = None,
    unexplained_n2: float | None = None,
) -> ClosedForm:
    """The closed form of an arm, expanded near the command where that is enough, which is faster.

    Args:
        arm: the arm.
        tare_samples: readings averaged into a tare.
        exact: never expanded.
        pose_corrections: by default as many as the arm calls for.
        unexplained_n2: what no statics carries, N²; by default what the arm's effects make of it.
    """
    nominal = mechanism_of(arm)
    mechanism = amended(nominal, entries_of(arm))
    # where holes are elsewhere, the held lengths are not the arm's own
    holes = "hole_y_m", "hole_z_m", "segment_hole_y_m", "segment_hole_z_m"
    own_lengths = all(np.array_equal(getattr(mechanism, h), getattr(nominal, h)) for h in holes)
    needed = pose_corrections_for(mechanism)
    stiff = needed <= 1 and own_lengths and not mechanism.joint_stiffness_n_m_rad.any()
    if pose_corrections is None:
        pose_corrections = needed if exact and stiff else max(_LEAST_CORRECTIONS, needed)
    return (NearCommand if stiff and not exact else ClosedForm)(
        mechanism,
        difference_variance_n2(arm.sensors, tare_samples),
        pose_corrections,
        unexplained_variance_n2(arm) if unexplained_n2 is None else unexplained_n2,
        held_by=None if own_lengths else nominal,
        unread=unreading(arm),
    )


def unexplained_variance_n2(arm: Arm) -> float:
    """Mean square of what the arm's effects make of tension differences and statics does not."""
    entries = entries_of(arm)
    if not (actuations([entries]) or transmissions([entries]) or sensings([entries])):
        return 0.0
    force_high_n = _BORNE_BENT * contact_range_n(arm)
    options = {"samples": _JUDGED_SAMPLES, "pose": "random", "noise": False}
    options |= {"kind": SingleContact.kind, "force_high_n": force_high_n}
    drawn = draw_dataset(arm, protocol_from_options(options, arm))
    nominal = mechanism_of(arm)
    mechanism, held = amended(nominal, entries), held_lengths_m(nominal, drawn.command_rad)
    loaded, unloaded = (
        solve_equilibrium(mechanism, drawn.command_rad, forces, held_m=held).tensions_n
        for forces in (drawn.forces_n, np.zeros_like(drawn.forces_n))
    )
    differences_n, unread = drawn.tension_difference_n, unreading(arm)
    if unread is not None:
        differences_n = differences_n @ unread
    return float(((differences_n - (loaded - unloaded)) ** 2).mean())


def unreading(arm: Arm) -> Array | None:
    """(M, M) by which rows of tension differences as read become those of the tensions.

    At rest, for differences as small as a newton; None where readings are tensions.
    """
    count = arm.cable_count
    tensions_n = arm.cables.pretension_n + np.vstack([np.zeros(count), np.eye(count)])
    nothing, *each = sensed_along_n(entries_of(arm), np.zeros(1), tensions_n[:, None])[:, 0]
    gains = np.array(each) - nothing
    return None if np.allclose(gains, np.eye(count)) else np.linalg.inv(gains)


class StaticsNetwork(ContactNetwork):
    """A network on the closed form of an arm, in float64."""

    pose_aware: ClassVar[bool] = True
    exact: ClassVar[bool] = False
    """Whether the closed form is never expanded near the command."""

    def __init__(self, closed_form: ClosedForm) -> None:
        kinematics = closed_form.kinematics
        super().__init__(kinematics.cable_count, kinematics.segment_count)
        self.closed_form = closed_form

    @classmethod
    def for_arm(cls, arm: Arm, tare_samples: int = 50) -> Self:
        """The network of an arm, its sensors, and a tare averaged over `tare_samples` readings."""
        return cls(statics(arm, tare_samples, exact=cls.exact))

    def adapt(self, tension_difference_n: Tensor, magnitude_n: Tensor) -> None:
        """Only the loss needs a scale, and counts magnitudes in the sensors' own noise."""
        self.magnitude.std.fill_(self.closed_form.reading_variance_n2**0.5)

    def balance(self, tension_difference_n: Tensor, joint_command_rad: Tensor | None) -> Balance:
        """Statics of tension differences (B, M) at joint commands (B, 2N)."""
        assert joint_command_rad is not None
        return self.closed_form(tension_difference_n.double(), joint_command_rad.double())


class AnywhereStatics(StaticsNetwork):
    """Statics of contacts anywhere: nothing is learnt but a factor of the stated deviations.

    The posterior of place and force follows outside the graph (`inference.anywhere`).
    """

    def __init__(self, closed_form: ClosedForm) -> None:
        super().__init__(closed_form)
        self.spread = StatedSpread(1)
        self.double()

    def forward(
        self, tension_difference_n: Tensor, joint_command_rad: Tensor | None = None
    ) -> Balance:
        """See the base class."""
        found = self.balance(tension_difference_n, joint_command_rad)
        return found._replace(precision=found.precision * self.spread.factor**-2)


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

    @classmethod
    def untrained(cls, arm: Arm, tare_samples: int) -> Self:
        """The baseline: statics at the commanded pose; nothing in it is trained."""
        network = cls(statics(arm, tare_samples, exact=True, pose_corrections=0))
        return network.requires_grad_(False)

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
        std_n = found.std_n * torch.exp(widen) * self.spread.factor
        return contact_of(evidence, force_n, std_n), balance.taut


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
        """See the base class."""
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
        held = ((1.0 - touched) * _UNTOUCHED_PRECISION)[:, :, None].expand(-1, -1, 2)
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
