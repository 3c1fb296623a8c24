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

    def tension_log_loss(self, spans_m: Array, bends_rad: Array) -> tuple[Array, Array] | None:
        """Logarithm of the tension at the actuator over that in each span, and its slope.

        The loss is (P, M, N), its derivative by how far the cable is drawn past each joint's
        guides (`drawn_m`) (P, M, N, N): span, guide.
        """
        return None

    def joint_torque_n_m(self, angles_rad: Array) -> tuple[Array, Array] | None:
        """Torques (P, 2N) that resist, and their derivative by each joint's own angle."""
        return None

    def settle(self, rest: Rest) -> None:
        """Take the rest that was reached."""


def drawn_m(spans_m: Array) -> Array:
    """How far each cable lies drawn towards its actuator at each joint's guides, (P, M, N).

    The far end is fixed, so what has shrunk beyond a guide has passed it. The middle of a joint's
    own span stands for its two guides.
    """
    beyond = np.flip(np.cumsum(np.flip(spans_m, -1), -1), -1)
    return np.asarray(0.5 * spans_m - beyond)
