"""What happens along the cables and in the joints and depends on the past."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from cablesense_sim.mechanism import Mechanism

Array = NDArray[np.float64]


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
    needs; `settle` then says what came of it, and only there may the state change.
    """

    def begin(self, mechanism: Mechanism, rest: Rest) -> None:
        """The state before the first sample; `rest` is that of the arm without the past."""

    def lengthening_m(self, time_s: float) -> Array | None:
        """(P, M) by which the cables are longer than when they were tensioned."""
        return None

    def hold(self, rest_m: Array) -> None:
        """Hear the spans' lengths (P, M) at which the cables are just slack, before a search."""

    def kept_tension(self, spans_m: Array, bends_rad: Array) -> Kept | None:
        """What friction leaves of the tension along the cables."""
        return None

    def joint_torque_n_m(self, angles_rad: Array) -> tuple[Array, Array] | None:
        """Torques (P, 2N) that resist, and their derivative by each joint's own angle."""
        return None

    def settle(self, rest: Rest) -> None:
        """Take the rest that was reached."""
