"""How strong a protocol's loads are: all cables taut, or some slack and the arm still safe."""

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
BEYOND_SLACK, REST_MARGIN = 1.5, 1.3
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
    tensions = _tensions_n(mechanism, command_rad, segment, magnitude_n[:, None] * direction)
    unloaded = tensions[0]
    least = np.minimum(_TAUT_SHARE * mechanism.pretension_n, 0.5 * unloaded)
    taut = _last_in_row((tensions >= least).all(axis=1) & _readable(arm, tensions))
    floor_n = float(np.sqrt(reading_variance_n2(arm.sensors)))
    shows = np.abs(tensions - unloaded).max(axis=1) >= _WORTH_FLOORS * floor_n
    weakest = int(np.argmax(shows)) if shows.any() else len(shows) - 1
    return float(magnitude_n[max(taut, weakest)])


def slackening_load_n(arm: Arm, command_rad: Array, segment: int, direction: Array) -> float:
    """A force in N along `direction` (3,) on segment 1..N that takes some cable slack, safely.

    Half as strong again as the weakest that does, and never so strong that the nominal arm would
    be without a rest at 1.3 times the force, or a sensor near the end of its range. Where there is
    none up to `STRONGEST_N`, the force of `bearable_load_n`.

    Raises:
        EquilibriumError: the arm finds no rest at the command (2N,) even unloaded.
    """
    mechanism = Mechanism.from_arm(arm)
    magnitude_n = np.arange(0.0, REST_MARGIN * STRONGEST_N + STEP_N, STEP_N)
    tensions = _tensions_n(mechanism, command_rad, segment, magnitude_n[:, None] * direction)
    slack = (tensions <= 0.0).any(axis=1)
    weakest_n = float(magnitude_n[np.argmax(slack)])
    safe_n = float(magnitude_n[len(tensions) - 1]) / REST_MARGIN
    readable_n = float(magnitude_n[_last_in_row(_readable(arm, tensions))])
    wanted_n = min(STRONGEST_N, BEYOND_SLACK * weakest_n, safe_n, readable_n) // STEP_N * STEP_N
    if not slack.any() or wanted_n <= weakest_n:
        return bearable_load_n(arm, command_rad, segment, direction)
    return wanted_n


def _readable(arm: Arm, tensions_n: Array) -> NDArray[np.bool_]:
    """(L,) whether no load takes a sensor near the end of its range that is not there unloaded."""
    most = np.inf if arm.sensors.range_n is None else _RANGE_SHARE * arm.sensors.range_n[1]
    return np.asarray((tensions_n <= max(most, tensions_n[0].max())).all(axis=1))


def _last_in_row(holds: NDArray[np.bool_]) -> int:
    """Position of the last entry before the first that does not hold."""
    return len(holds) - 1 if holds.all() else int(np.argmin(holds)) - 1


def _tensions_n(mechanism: Mechanism, command_rad: Array, segment: int, loads_n: Array) -> Array:
    """Tensions (L, M) of loads (L, 3) from the weakest up, as far as the arm finds rest."""
    forces_n = np.zeros((len(loads_n), mechanism.segment_count, 3))
    forces_n[:, segment - 1] = loads_n
    try:
        return solve_equilibrium(mechanism, command_rad, forces_n).tensions_n
    except EquilibriumError as error:
        if not error.failed.size or error.failed[0] == 0:
            raise
        borne = forces_n[: int(error.failed[0])]
        return solve_equilibrium(mechanism, command_rad, borne).tensions_n
