"""Whether the arm may be moving: while it is, its tensions tell nothing of contacts."""

from __future__ import annotations

import numpy as np

from cablesense_base.arrays import Array
from cablesense_sim.joint_motion import move_duration_s

_LONG_AGO_NS = -(2**62)


class MotionGate:
    """Closed from a changed command until the arm must have arrived and come to rest.

    How far the joints have got is not known, only what they were commanded: while moving, any
    angle between the commands since the last rest counts as possible, and the longest way from
    there is waited for.

    Time is that of the samples' stamps, so that a recording has the same answers: a command counts
    from the first sample after it. Where stamps step back, what is left to wait is kept.

    Attributes:
        stepped_back: whether the last sample's stamp lay before that of the one before it.
    """

    def __init__(self, command_rad: Array, joint_speed_rad_s: float, settle_s: float) -> None:
        """At rest at `command_rad` (2N,); `settle_s` is waited after each arrival."""
        self._speed_rad_s = joint_speed_rad_s
        self._settle_s = settle_s
        self._lowest_rad = self._highest_rad = command_rad.copy()
        self._command_rad = command_rad.copy()
        self._rest_from_ns = _LONG_AGO_NS
        self._last_ns = _LONG_AGO_NS
        self._starting = False
        self.stepped_back = False

    def command(self, command_rad: Array) -> bool:
        """Take note of a command (2N,); gives whether it differs from the one before."""
        if np.array_equal(command_rad, self._command_rad):
            return False
        if not self.shut:
            self._lowest_rad = self._highest_rad = self._command_rad
        self._command_rad = command_rad.copy()
        self._lowest_rad = np.minimum(self._lowest_rad, command_rad)
        self._highest_rad = np.maximum(self._highest_rad, command_rad)
        self._starting = True
        return True

    def moving(self, stamp_ns: int) -> bool:
        """Whether the arm may still move, or swing, at the next sample's stamp."""
        self.stepped_back = stamp_ns < self._last_ns
        if self.stepped_back:
            self._rest_from_ns -= self._last_ns - stamp_ns
        self._last_ns = stamp_ns
        if self._starting:
            self._starting = False
            self._rest_from_ns = stamp_ns + self._wait_ns()
        return stamp_ns < self._rest_from_ns

    @property
    def shut(self) -> bool:
        """Whether the arm may have been moving at the last sample, or has been told to since."""
        return self._starting or self._last_ns < self._rest_from_ns

    @property
    def command_rad(self) -> Array:
        """(2N,) the last command."""
        return self._command_rad

    @property
    def rest_from_ns(self) -> int:
        """Stamp from which on the arm rests, as known at the last sample."""
        return self._rest_from_ns

    @property
    def range_rad(self) -> tuple[Array, Array]:
        """Lowest and highest angles (2N,) that count as possible until then."""
        return self._lowest_rad, self._highest_rad

    def restore(
        self, command_rad: Array, lowest_rad: Array, highest_rad: Array, rest_from_ns: int
    ) -> None:
        """Be as another gate was when a sample began."""
        self._command_rad = command_rad
        self._lowest_rad, self._highest_rad = lowest_rad, highest_rad
        self._rest_from_ns, self._last_ns = rest_from_ns, _LONG_AGO_NS
        self._starting = False

    def _wait_ns(self) -> int:
        longest = max(
            float((self._highest_rad - self._command_rad).max()),
            float((self._command_rad - self._lowest_rad).max()),
        )
        return round((move_duration_s(longest, self._speed_rad_s) + self._settle_s) * 1e9)
