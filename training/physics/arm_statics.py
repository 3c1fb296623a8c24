"""The closed form of an arm file, effects included as far as statics can carry them.

What effects change of the arm itself is in the closed form: masses, stiffness, holes, springs,
contact points, while the actuators hold the lengths of the arm without them. What depends on the
past, and what sensors and actuators do, no closed form knows; it counts as spread of the readings.
"""

from __future__ import annotations

import numpy as np

from cablesense_sim.arm import Arm
from cablesense_sim.effects.chains import actuations, amended, memories, sensings
from cablesense_sim.effects.entry import entries_of
from cablesense_sim.equilibrium import held_lengths_m, solve_equilibrium
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.sensors import difference_variance_n2
from cablesense_training.data import Dataset, SingleContact
from cablesense_training.physics.closed_form import ClosedForm, pose_corrections_for
from cablesense_training.physics.second_order import SecondOrderClosedForm

_JUDGED_SAMPLES = 256
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
    nominal = Mechanism.from_arm(arm)
    mechanism = amended(nominal, entries_of(arm))
    if pose_corrections is None:
        pose_corrections = pose_corrections_for(mechanism)
        if _holds_other_lengths(mechanism, nominal):
            pose_corrections = max(pose_corrections, _LEAST_CORRECTIONS_OF_ANOTHER_GEOMETRY)
    return ClosedForm(
        mechanism,
        difference_variance_n2(arm.sensors, tare_samples),
        pose_corrections,
        unexplained_variance_n2(arm) if unexplained_n2 is None else unexplained_n2,
        nominal if _holds_other_lengths(mechanism, nominal) else None,
    )


def statics(arm: Arm, tare_samples: int) -> ClosedForm | SecondOrderClosedForm:
    """The closed form of an arm; to second order where that is enough, which is faster."""
    nominal = Mechanism.from_arm(arm)
    mechanism = amended(nominal, entries_of(arm))
    plain = not mechanism.joint_stiffness_n_m_rad.any()
    plain = plain and not _holds_other_lengths(mechanism, nominal)
    if plain and pose_corrections_for(mechanism) <= 1:
        variance = difference_variance_n2(arm.sensors, tare_samples)
        return SecondOrderClosedForm(mechanism, variance, unexplained_variance_n2(arm))
    return exact_statics(arm, tare_samples)


def _holds_other_lengths(mechanism: Mechanism, nominal: Mechanism) -> bool:
    """Whether holes are elsewhere, so that the held lengths are not the arm's own."""
    return not (
        mechanism.segment_hole_y_m is None
        and np.array_equal(mechanism.hole_y_m, nominal.hole_y_m)
        and np.array_equal(mechanism.hole_z_m, nominal.hole_z_m)
    )


def unexplained_variance_n2(arm: Arm) -> float:
    """Mean square of what the arm's effects make of tension differences and statics does not."""
    entries = entries_of(arm)
    if not (actuations([entries]) or memories([entries]) or sensings([entries])):
        return 0.0
    protocol = SingleContact(samples=_JUDGED_SAMPLES, pose="random", noise=False)
    seen = Dataset.from_protocol(arm, protocol)
    nominal = Mechanism.from_arm(arm)
    mechanism, held = amended(nominal, entries), held_lengths_m(nominal, seen.command_rad)
    loaded, unloaded = (
        solve_equilibrium(mechanism, seen.command_rad, forces, held_m=held).tensions_n
        for forces in (seen.forces_n, np.zeros_like(seen.forces_n))
    )
    return float(((seen.tension_difference_n - (loaded - unloaded)) ** 2).mean())
