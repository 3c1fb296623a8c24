"""What is history-dependent along the cables and in the joints; dry friction as a state."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cablesense_base.arrays import Array
from cablesense_sim.mechanism import Mechanism


class Rest(NamedTuple):
    """Where P arms side by side rest at one moment.

    Attributes:
        time_s: the moment.
        angles_rad: (P, 2N) joint angles.
        spans_m: (P, M, N) cables' spans across the joints, zero where a cable does not pass.
        bends_rad: (P, M, N, 2) by how much a cable turns at the guides before and after a joint.
        tensions_n: (P, M) at the actuators.
    """

    time_s: float
    angles_rad: Array
    spans_m: Array
    bends_rad: Array
    tensions_n: Array


class Kept(NamedTuple):
    """Tension in each span of a cable, and its mean over the cable's stretch, by the actuator's.

    Attributes:
        spans: (P, M, N).
        spans_by_m: (P, M, N, N) derivative by the lengths of the cable's spans.
        mean: (P, M).
        mean_by_m: (P, M, N).
    """

    spans: Array
    spans_by_m: Array
    mean: Array
    mean_by_m: Array

    @classmethod
    def all_of(cls, spans_m: Array) -> Kept:
        """Without friction, of cables with spans (P, M, N)."""
        return cls(
            np.ones_like(spans_m),
            np.zeros((*spans_m.shape, spans_m.shape[-1])),
            np.ones(spans_m.shape[:-1]),
            np.zeros_like(spans_m),
        )

    def and_then(self, other: Kept) -> Kept:
        """One friction after another: what they leave multiplies."""
        return Kept(
            self.spans * other.spans,
            self.spans_by_m * other.spans[..., None] + self.spans[..., None] * other.spans_by_m,
            self.mean * other.mean,
            self.mean_by_m * other.mean[..., None] + self.mean[..., None] * other.mean_by_m,
        )


class Transmission:
    """Base: an ideal transmission. Holds the state of P arms side by side, from rest to rest.

    The search for the next rest asks for everything but `settle` at trial poses, as often as it
    needs; `settle` then gives what came of it, and only there may the state change.
    """

    def begin(self, mechanism: Mechanism, rest: Rest) -> None:
        """The state before the first sample; `rest` is that of the arm without the past."""

    def lengthening_m(self, time_s: float) -> Array | None:
        """(P, M) by which the cables are longer than when they were tensioned."""
        return None

    def hold(self, rest_m: Array) -> None:
        """Take the spans' lengths (P, M) at which the cables are just slack, before a search."""

    def kept_tension(self, spans_m: Array, bends_rad: Array) -> Kept | None:
        """What friction leaves of the tension along the cables."""
        return None

    def joint_torque_n_m(self, angles_rad: Array) -> tuple[Array, Array] | None:
        """Torques (P, 2N) that resist, and their derivative by each joint's own angle."""
        return None

    def settle(self, rest: Rest) -> None:
        """Take the rest that was reached."""


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
