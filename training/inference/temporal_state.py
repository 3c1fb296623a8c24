"""What a model with memory carries from tick to tick, number by number."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TemporalState:
    """Places of the parts in a state (…, size) of an arm with N segments and M cables.

    In order: the recurrent unit's own state; stop operators on the commanded cable lengths, a
    share from -1 to 1 for each cable and give; those lengths (M,) and the set-point (2N,); shares
    and set-point as they were at the tare; one where all this is known, and zero before that.

    Attributes:
        hidden: size of the recurrent unit's state.
        shares: number of shares, M times the number of gives.
        cables, joints: M and 2N.
    """

    hidden: int
    shares: int
    cables: int
    joints: int

    @classmethod
    def of_size(cls, size: int, hidden: int, cables: int, joints: int) -> TemporalState:
        """From the whole size."""
        return cls(hidden, (size - hidden - cables - 2 * joints - 1) // 2, cables, joints)

    @property
    def parts(self) -> tuple[int, ...]:
        """Sizes of the parts in their order."""
        return (
            self.hidden,
            self.shares,
            self.cables,
            self.joints,
            self.shares,
            self.joints,
            1,
        )

    @property
    def size(self) -> int:
        """Of all parts together."""
        return sum(self.parts)

    def tared(self, state: Array) -> Array:
        """The state (…, size) right after a tare: nothing heard, what was drawn still known."""
        _, shares, lengths, set_point, _, _, known = np.split(
            state, np.cumsum(self.parts)[:-1], axis=-1
        )
        nothing = np.zeros((*state.shape[:-1], self.hidden))
        return np.concatenate(
            [nothing, shares, lengths, set_point, shares, set_point, known], axis=-1
        )
