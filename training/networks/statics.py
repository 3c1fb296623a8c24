"""The closed form that suits an arm file, the networks on it, and effects it cannot carry.

The closed form contains the effects on the arm itself: masses, stiffness, holes, springs, contact
points, while the actuators hold the lengths of the arm without them. `unreading` undoes what
sensors that do not err by the past make of tensions. No closed form knows history-dependent
effects and the actuators; they count as spread of the readings.
"""

from __future__ import annotations

from typing import ClassVar, Self

import numpy as np
from torch import Tensor

from cablesense_base import Array
from cablesense_sim.arm import Arm
from cablesense_sim.build import entries_of, mechanism_of
from cablesense_sim.effects.registry import actuations, amended, sensings, transmissions
from cablesense_sim.equilibrium import held_lengths_m, solve_equilibrium
from cablesense_sim.load_capacity import contact_range_n
from cablesense_sim.replay import difference_variance_n2
from cablesense_training.data.generation import draw_dataset
from cablesense_training.data.history import sensed_along_n
from cablesense_training.data.protocols import SingleContact, protocol_from_options
from cablesense_training.networks.closed_form import Balance, ClosedForm, pose_corrections_for
from cablesense_training.networks.layers import ContactNetwork, StatedSpread
from cablesense_training.networks.near_command import NearCommand

_JUDGED_SAMPLES, _BORNE_BENT = 256, 0.5
"""How many contacts spread is judged on, and up to which share of what the straight arm bears."""
_LEAST_CORRECTIONS = 2
"""Residuals of a stiff arm's cable lengths need one more than its torques."""


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


class StaticsNetwork(ContactNetwork):
    """A network on the closed form of an arm, in float64.

    Args:
        closed_form: statics of the arm.

    Attributes:
        exact: whether that is never expanded near the command.
    """

    pose_aware: ClassVar[bool] = True
    exact: ClassVar[bool] = False

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
        """See the base class; the commanded angles are needed."""
        found = self.balance(tension_difference_n, joint_command_rad)
        return found._replace(precision=found.precision * self.spread.factor**-2)


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
