"""What cables pull with, as their transmission answers it."""

from __future__ import annotations

from typing import NamedTuple

from cablesense_base import Array


class CablePull(NamedTuple):
    """Tensions of cables in K = 1 + N pieces: at the actuator, and across each joint.

    Attributes:
        tensions_n: (..., K) of each piece, the actuator's first; zero in a slack cable.
        by_length_n_m: (..., K, K) derivative by the pieces' lengths.
    """

    tensions_n: Array
    by_length_n_m: Array
