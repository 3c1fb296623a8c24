"""Tensions at rest for many cases at once, also when a few of them have no rest to find."""

import numpy as np
from numpy.typing import NDArray

from cablesense_sim.equilibrium import EquilibriumError, solve_equilibrium
from cablesense_sim.mechanism import Mechanism

Array = NDArray[np.float64]


class TooManyFailures(Exception):  # noqa: N818
    """More cases without equilibrium than were allowed; the text gives one, and why."""


def tensions_at_rest_n(
    mechanism: Mechanism, command_rad: Array, forces_n: Array, allowed_failures: int
) -> Array:
    """Tensions (B, M) for commands (B, 2N) and forces (B, N, 3); NaN in rows without equilibrium.

    Raises:
        TooManyFailures: more than `allowed_failures` rows have no equilibrium.
    """
    tensions = np.full((len(command_rad), mechanism.cable_count), np.nan)
    rows = np.arange(len(command_rad))
    try:
        rest = solve_equilibrium(mechanism, command_rad, forces_n)
    except EquilibriumError as error:
        if not 0 < error.failed.size <= allowed_failures:
            raise TooManyFailures(str(error)) from error
        rows = np.delete(rows, error.failed)
        rest = solve_equilibrium(mechanism, command_rad[rows], forces_n[rows])
    tensions[rows] = rest.tensions_n
    return tensions
