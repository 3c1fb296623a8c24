"""What the sensors of an arm read with nothing touching it, by its description."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cablesense_sim.arm import Arm
from cablesense_sim.effects.chains import amended
from cablesense_sim.effects.entry import entries_of
from cablesense_sim.equilibrium import held_lengths_m, solve_equilibrium
from cablesense_sim.mechanism import Mechanism

Array = NDArray[np.float64]


class UnloadedTensions:
    """The static equilibrium of an arm that is commanded as if its effects were unknown.

    Attributes:
        mechanism: the arm with what its effects change of it.
    """

    def __init__(self, arm: Arm) -> None:
        self._nominal = Mechanism.from_arm(arm)
        self.mechanism = amended(self._nominal, entries_of(arm))

    def predict_n(self, command_rad: Array) -> Array:
        """Tensions (M,) at rest at a command (2N,).

        Raises:
            CableSenseError: the arm has no rest at this command.
        """
        held = held_lengths_m(self._nominal, command_rad)
        return solve_equilibrium(self.mechanism, command_rad, held_m=held).tensions_n
