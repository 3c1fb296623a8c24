"""Tensions at rest for many cases at once, also when a few of them have no rest to find."""

import numpy as np
from numpy.typing import NDArray

from cablesense_sim.equilibrium import EquilibriumError, solve_equilibrium
from cablesense_sim.mechanism import Mechanism

Array = NDArray[np.float64]

_BRANCHES = 8


class TooManyFailures(Exception):  # noqa: N818
    """More cases without equilibrium than were allowed; the text gives one, and why."""


def tensions_at_rest_n(
    mechanism: Mechanism, command_rad: Array, forces_n: Array, allowed_failures: int
) -> Array:
    """Tensions (B, M) for commands (B, 2N) and forces (B, N, 3); NaN in rows without equilibrium.

    The solver refuses a batch as a whole, so a refused batch is split until what fails stands
    alone.

    Raises:
        TooManyFailures: more than `allowed_failures` rows have no equilibrium.
    """
    tensions = np.full((len(command_rad), mechanism.cable_count), np.nan)
    batches = [np.arange(len(command_rad))]
    alone = 0
    while batches:
        refused = []
        for rows in batches:
            try:
                rest = solve_equilibrium(mechanism, command_rad[rows], forces_n[rows])
            except EquilibriumError as error:
                # batches do not overlap, so each that is refused holds a failure of its own
                refused.append(rows)
                if alone + len(refused) > allowed_failures:
                    raise TooManyFailures(str(error)) from error
            else:
                tensions[rows] = rest.tensions_n
        alone += sum(len(rows) == 1 for rows in refused)
        batches = [
            part
            for rows in refused
            if len(rows) > 1
            for part in np.array_split(rows, min(_BRANCHES, len(rows)))
        ]
    return tensions
