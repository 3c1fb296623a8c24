"""Tensions at rest for many cases at once, also when a few of them have no rest to find."""

import numpy as np
from numpy.typing import NDArray

from cablesense_sim.equilibrium import EquilibriumError, solve_equilibrium
from cablesense_sim.mechanism import Mechanism

Array = NDArray[np.float64]


class TooManyFailures(Exception):  # noqa: N818
    """More cases without equilibrium than were allowed; holds the reason of the last one met."""


def tensions_at_rest_n(
    mechanism: Mechanism, command_rad: Array, forces_n: Array, allowed_failures: int
) -> Array:
    """Tensions (B, M) for commands (B, 2N) and forces (B, N, 3); NaN in rows without equilibrium.

    The solver refuses a batch as a whole, so a refused batch is halved until what fails stands
    alone.

    Raises:
        TooManyFailures: more than `allowed_failures` rows have no equilibrium.
    """
    tensions = np.full((len(command_rad), mechanism.cable_count), np.nan)
    failures = 0
    open_ = [slice(0, len(command_rad))]
    while open_:
        rows = open_.pop()
        try:
            rest = solve_equilibrium(mechanism, command_rad[rows], forces_n[rows])
        except EquilibriumError as error:
            if rows.stop - rows.start > 1:
                middle = (rows.start + rows.stop) // 2
                open_ += [slice(middle, rows.stop), slice(rows.start, middle)]
                continue
            failures += 1
            if failures > allowed_failures:
                raise TooManyFailures(str(error)) from error
        else:
            tensions[rows] = rest.tensions_n
    return tensions
