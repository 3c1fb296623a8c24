"""Whether the arm may be moving: while it is, its tensions tell nothing of contacts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cablesense_sim.joint_motion import move_duration_s

Array = NDArray[np.float64]


class MotionGate:
    """Closed from a changed command until the arm must have arrived and come to rest.

    How far the joints have got is not known, only what they were commanded: while moving, any
    angle between the commands since the last rest counts as possible, and the longest way from
    there is waited for.
    """

    def __init__(self, command_rad: Array, joint_speed_rad_s: float, settle_s: float) -> None:
        """At rest at `command_rad` (2N,); `settle_s` is waited after each arrival."""
        self._speed_rad_s = joint_speed_rad_s
        self._settle_s = settle_s
        self._lowest_rad = self._highest_rad = command_rad.copy()
        self._command_rad = command_rad.copy()
        self._until_s = float("-inf")

    def command(self, command_rad: Array, now_s: float) -> bool:
        """Take note of a command (2N,); gives whether it differs from the one before."""
        if np.array_equal(command_rad, self._command_rad):
            return False
        if not self.moving(now_s):
            self._lowest_rad = self._highest_rad = self._command_rad
        self._command_rad = command_rad.copy()
        self._lowest_rad = np.minimum(self._lowest_rad, command_rad)
        self._highest_rad = np.maximum(self._highest_rad, command_rad)
        longest = max(
            float((self._highest_rad - command_rad).max()),
            float((command_rad - self._lowest_rad).max()),
        )
        self._until_s = now_s + move_duration_s(longest, self._speed_rad_s) + self._settle_s
        return True

    def moving(self, now_s: float) -> bool:
        """Whether the arm may still move, or swing."""
        return now_s < self._until_s
