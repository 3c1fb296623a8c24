"""The strongest load of a protocol: one that shows well and leaves no cable slack."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cablesense_sim.arm import Arm
from cablesense_sim.equilibrium import EquilibriumError, solve_equilibrium
from cablesense_sim.mechanism import Mechanism
from cablesense_sim.sensors import reading_variance_n2

Array = NDArray[np.float64]

STRONGEST_N = 60.0
"""What a person hangs on an arm or pulls over a pulley without a crane."""
STEP_N = 2.0
"""Loads are whole multiples of this, so that a quarter of one can still be set by hand."""
_TAUT_SHARE = 0.1
"""Cables keep this share of their pretension, so that workshop scatter leaves them taut too."""
_RANGE_SHARE = 0.9
_WORTH_FLOORS = 20.0


def bearable_load_n(arm: Arm, command_rad: Array, segment: int, direction: Array) -> float:
    """Largest force in N along `direction` (3,) on segment 1..N that leaves every cable taut.

    A multiple of `STEP_N`, at most `STRONGEST_N`. Where no force that shows (20 noise floors in
    some cable) leaves all cables taut, the weakest that shows.

    Raises:
        EquilibriumError: the arm finds no rest at the command (2N,) even unloaded.
    """
    mechanism = Mechanism.from_arm(arm)
    magnitude_n = np.arange(0.0, STRONGEST_N + STEP_N, STEP_N)
    forces = np.zeros((len(magnitude_n), mechanism.segment_count, 3))
    forces[:, segment - 1] = magnitude_n[:, None] * direction
    tensions = _bearable_tensions_n(mechanism, command_rad, forces)
    unloaded = tensions[0]
    least = np.minimum(_TAUT_SHARE * mechanism.pretension_n, 0.5 * unloaded)
    most = np.inf if arm.sensors.range_n is None else _RANGE_SHARE * arm.sensors.range_n[1]
    fits = ((tensions >= least) & (tensions <= max(most, unloaded.max()))).all(axis=1)
    taut = len(fits) - 1 if fits.all() else int(np.argmin(fits)) - 1
    floor_n = float(np.sqrt(reading_variance_n2(arm.sensors)))
    shows = np.abs(tensions - unloaded).max(axis=1) >= _WORTH_FLOORS * floor_n
    weakest = int(np.argmax(shows)) if shows.any() else len(shows) - 1
    return float(magnitude_n[max(taut, weakest)])


def _bearable_tensions_n(mechanism: Mechanism, command_rad: Array, forces_n: Array) -> Array:
    """Tensions (L, M) of the loads from the weakest up, as far as the arm finds rest."""
    try:
        return solve_equilibrium(mechanism, command_rad, forces_n).tensions_n
    except EquilibriumError as error:
        if not error.failed.size or error.failed[0] == 0:
            raise
        borne = forces_n[: int(error.failed[0])]
        return solve_equilibrium(mechanism, command_rad, borne).tensions_n
