"""The closed form, weighed and corrected by a small network: the estimator that CableSense ships.

Statics gives one candidate per segment with its information. Little remains to be learnt: how much
its evidence counts against "no contact", where many slack cables bend the estimate, and how wide
the error really is. Corrections are counted in standard deviations of the closed form and bounded,
so that an arm unlike the training data still gets an answer by statics.

The closed form contains the effects on the arm itself: masses, stiffness, holes, springs, contact
points, while the actuators hold the lengths of the arm without them; so is what sensors that do
not err by the past make of tensions. No closed form knows history-dependent effects and the
actuators; they count as spread of the readings.
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from cablesense_base import Array
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.effects.registry import actuations, amended, sensings, transmissions
from cablesense_sim.equilibrium import held_lengths_m, solve_equilibrium
from cablesense_sim.load_capacity import contact_range_n
from cablesense_sim.replay import difference_variance_n2
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.history import sensed_along_n
from cablesense_training.data.protocols import SingleContact
from cablesense_training.errors import TrainingError
from cablesense_training.inference.history_simulation import depends_on_history, without_history
from cablesense_training.inference.metadata import HISTORY_SIMULATED
from cablesense_training.networks.closed_form import Candidates, ClosedForm, pose_corrections_for
from cablesense_training.networks.layers import (
    SingleContactOutput,
    StatedSpread,
    one_hot_of_argmax,
)
from cablesense_training.networks.second_order import SecondOrderClosedForm
from cablesense_training.networks.single_contact import SingleContactNetwork

_JUDGED_SAMPLES, _BORNE_BENT = 256, 0.5
"""How many contacts spread is judged on, and up to which share of what the straight arm bears."""
_LEAST_CORRECTIONS_OF_ANOTHER_GEOMETRY = 2


def exact_statics(
    arm: Arm,
    tare_samples: int,
    pose_corrections: int | None = None,
    unexplained_n2: float | None = None,
) -> ClosedForm:
    """The closed form of an arm, with as many pose corrections as it calls for, or as given.

    `unexplained_n2` is what no statics carries, N²; by default what the arm's effects make of it.
    """
    nominal = mechanism_of(arm)
    mechanism = amended(nominal, entries_of(arm))
    # where holes are elsewhere, the held lengths are not the arm's own
    own_lengths = (
        mechanism.segment_hole_y_m is None
        and np.array_equal(mechanism.hole_y_m, nominal.hole_y_m)
        and np.array_equal(mechanism.hole_z_m, nominal.hole_z_m)
    )
    if pose_corrections is None:
        pose_corrections = pose_corrections_for(mechanism)
        if not own_lengths:
            pose_corrections = max(pose_corrections, _LEAST_CORRECTIONS_OF_ANOTHER_GEOMETRY)
    return ClosedForm(
        mechanism,
        difference_variance_n2(arm.sensors, tare_samples),
        pose_corrections,
        unexplained_variance_n2(arm) if unexplained_n2 is None else unexplained_n2,
        None if own_lengths else nominal,
    )


def statics(
    arm: Arm, tare_samples: int, unexplained_n2: float | None = None
) -> ClosedForm | SecondOrderClosedForm:
    """`exact_statics` of an arm; to second order where that is enough, which is faster."""
    exact = exact_statics(arm, tare_samples, unexplained_n2=unexplained_n2)
    if exact.springy or exact.held_by is not None or exact.pose_corrections > 1:
        return exact
    return SecondOrderClosedForm(exact)


def unexplained_variance_n2(arm: Arm) -> float:
    """Mean square of what the arm's effects make of tension differences and statics does not."""
    entries = entries_of(arm)
    if not (actuations([entries]) or transmissions([entries]) or sensings([entries])):
        return 0.0
    force_high_n = _BORNE_BENT * contact_range_n(arm)
    protocol = SingleContact(
        samples=_JUDGED_SAMPLES, pose="random", force_high_n=force_high_n, noise=False
    )
    drawn = draw_dataset(arm, protocol)
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
    nothing, *each = sensed_along_n(entries_of(arm), np.zeros(1), tensions_n[None])[0]
    gains = np.array(each) - nothing
    return None if np.allclose(gains, np.eye(count)) else np.linalg.inv(gains)


LOG_PRIOR = -2.0 * math.log(200.0)
"""Of a contact: uniform over the disc of forces up to 200 N, but for pi."""

LARGEST_CORRECTION = 1.0
"""In standard deviations of the closed form."""


class CorrectedClosedForm(SingleContactNetwork):
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


class PlainClosedForm(CorrectedClosedForm):
    """The baseline: statics at the commanded pose; nothing in it is trained."""

    @classmethod
    def for_arm(cls, arm: Arm, tare_samples: int = 50) -> PlainClosedForm:
        """The closed form of an arm that is assumed to stand where it is commanded."""
        network = cls(arm, exact_statics(arm, tare_samples, pose_corrections=0))
        return network.requires_grad_(False)


class WithoutHistory(CorrectedClosedForm):
    """Behind a simulation that takes the arm's history out of the readings; trained as the base.

    See `inference.history_simulation`.
    """

    @classmethod
    def for_arm(cls, arm: Arm, tare_samples: int = 50) -> WithoutHistory:
        """The network of an arm without what depends on its history.

        Raises:
            TrainingError: nothing does.
        """
        if not depends_on_history(arm):
            raise TrainingError(
                f"network {HISTORY_SIMULATED} is for an arm file that lists friction, creep, "
                f"backlash or lagging sensors; {arm.identity} does not"
            )
        settled = without_history(arm)
        return cls(settled, statics(settled, tare_samples))


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
