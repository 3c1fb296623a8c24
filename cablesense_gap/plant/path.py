"""The way of a body without friction through a recording: each rest near the one before.

An arm with slack cables can have two rests under one load. Which one it takes, the way there
decides, and so a load is followed row by row from where it began. Loads that begin unloaded
do not know of each other: all of them are followed at once.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cablesense_gap.plant.body import Body
from cablesense_gap.plant.rest import Rest, commanded_angles_rad, find_rest

Array = NDArray[np.float64]


def follow(body: Body, command_rad: Array, paid_out_m: Array, loads_n: Array) -> Rest:
    """Rests of rows (R, 2N), (R, M), (R, N, 3) in their order.

    Raises:
        PlantError: rows without rest.
    """
    loaded = (loads_n != 0.0).any(axis=(1, 2))
    loaded[0] = False
    angles = commanded_angles_rad(body, command_rad)
    tensions = np.empty_like(paid_out_m)
    free = np.flatnonzero(~loaded)
    rest = find_rest(body, angles[free], paid_out_m[free], loads_n[free])
    angles[free], tensions[free] = rest.angles_rad, rest.tensions_n
    first = np.flatnonzero(loaded & ~np.roll(loaded, 1))
    changed = (np.diff(loads_n, axis=0) != 0.0).any(axis=(1, 2))
    changed = np.concatenate([[True], changed | (np.diff(paid_out_m, axis=0) != 0.0).any(axis=1)])
    rows = first
    while len(rows):
        new, same = rows[changed[rows]], rows[~changed[rows]]
        angles[same], tensions[same] = angles[same - 1], tensions[same - 1]
        if len(new):
            rest = find_rest(body, angles[new - 1], paid_out_m[new], loads_n[new])
            angles[new], tensions[new] = rest.angles_rad, rest.tensions_n
        rows = rows + 1
        rows = rows[rows < len(loaded)]
        rows = rows[loaded[rows]]
    return Rest(angles, tensions)
