"""Which simulation an arm runs in: in time, or from rest to rest where the past counts."""

from __future__ import annotations

from cablesense_sim.arm import Arm
from cablesense_sim.dynamics import ArmDynamics
from cablesense_sim.effects.chains import memories
from cablesense_sim.effects.entry import entries_of
from cablesense_sim.rest_to_rest import RestToRestArm


def moving_arm(arm: Arm, timestep_s: float) -> ArmDynamics | RestToRestArm:
    """The arm of a file with its effects, those of the sensors aside.

    Raises:
        EquilibriumError: it has no rest under its own weight.
    """
    if memories([entries_of(arm)]):
        return RestToRestArm(arm)
    return ArmDynamics(arm, timestep_s)
