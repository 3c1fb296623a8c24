"""Dry friction as a state: which share of its limit a contact carries, and how that lasts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class DryContact:
    """Contacts that carry a share between -1 and 1 of their limit, and keep it at rest.

    A share moves with the contact until it slips. Part of the contact is sharp, and yields evenly
    over `give` until it slips at once (Prandtl 1928); the rest is rounded, and nears its limit as
    exp(-moved / give) (Dahl, A solid friction model, Aerospace Corp. TOR-0158, 1968).
    """

    def __init__(self, give: Array, rounded: Array, start: Array, at: Array) -> None:
        """`start` is the share carried at the positions `at`; all broadcast together."""
        self._give, self._rounded = give, rounded
        self._sharp = self._round = np.broadcast_to(start, at.shape)
        self._at = at

    def share(self, at: Array) -> tuple[Array, Array]:
        """The share at new positions, and its derivative by them."""
        sharp, round_, free, full = self._moved(at)
        moved = at - self._at
        sharp_slope = np.abs(free) < 1.0
        round_slope = np.where(moved == 0.0, 1.0, np.abs(full - round_))
        return (
            (1.0 - self._rounded) * sharp + self._rounded * round_,
            ((1.0 - self._rounded) * sharp_slope + self._rounded * round_slope) / self._give,
        )

    def settle(self, at: Array) -> None:
        """Stay at these positions."""
        self._sharp, self._round, *_ = self._moved(at)
        self._at = at

    def _moved(self, at: Array) -> tuple[Array, Array, Array, Array]:
        moved = (at - self._at) / self._give
        free = self._sharp + moved
        full = np.sign(moved)
        round_ = full - (full - self._round) * np.exp(-np.abs(moved))
        return np.clip(free, -1.0, 1.0), np.where(moved == 0.0, self._round, round_), free, full
