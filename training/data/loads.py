"""The forces that a row of labels stands for."""

import numpy as np
from numpy.typing import NDArray

from cablesense_sim.loads import normal_force_n
from cablesense_sim.mechanism import Mechanism

Array = NDArray[np.float64]


def contact_forces_n(
    mechanism: Mechanism, command_rad: Array, angles_deg: Array, magnitudes_n: Array
) -> Array:
    """Contact forces (B, N, 3) in base axes for angles and magnitudes (B, N), one a segment.

    Each is normal to its segment at the commanded angles (B, 2N); where the magnitude is 0, so is
    the force.
    """
    forces = np.zeros((len(command_rad), mechanism.segment_count, 3))
    for n in range(mechanism.segment_count):
        rows = np.flatnonzero(magnitudes_n[:, n])
        segment = np.full(len(rows), n + 1)
        angle, magnitude = angles_deg[rows, n], magnitudes_n[rows, n]
        forces[rows] += normal_force_n(mechanism, command_rad[rows], segment, angle, magnitude)
    return forces
