"""Where an arm that remembers stands, and all that it remembers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class State:
    """One row of a march.

    Attributes:
        angles_rad: (2J,).
        tension_n: (2J + 2, M) of the pieces of the cables; the first is what the sensor feels.
        rub: (2J + 1, M) state of friction at the guides.
        fed_m: (2J + 1, M) cable that has passed each guide.
        joint_rub: (2J,) state of friction in the joints.
        speed_rad_s: (2J,) of the angles.
        crept_m: (K, M) lengthening of each element.
        paid_out_m: (M,) by the actuators.
        loads_n: (N, 3).
    """

    angles_rad: Array
    tension_n: Array
    rub: Array
    fed_m: Array
    joint_rub: Array
    speed_rad_s: Array
    crept_m: Array
    paid_out_m: Array
    loads_n: Array
