"""What actuators make of commanded lengths: play, wrong ratios, uneven screws, slipping clamps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Actuation:
    """Faults of M actuators.

    Attributes:
        play_m: (M,) lost motion on reversal, from end to end.
        play_start: (M,) where in the play each begins, -1 to 1.
        ratio: (M,) metres paid out for one that is commanded.
        screw_m: (M,) amplitude of an error periodic in the length.
        screw_pitch_m: its period.
        screw_phase_rad: (M,) its phase at the straight arm.
        slip_m: (M,) what each clamp lets through at `slip_time_s`.
        slip_time_s: when.
    """

    play_m: Array
    play_start: Array
    ratio: Array
    screw_m: Array
    screw_pitch_m: float
    screw_phase_rad: Array
    slip_m: Array
    slip_time_s: float

    def paid_out_m(self, commanded_m: Array, time_s: Array) -> Array:
        """(R, M) lengths given, of those commanded, both less that of the straight arm."""
        phase = 2.0 * np.pi * commanded_m / self.screw_pitch_m + self.screw_phase_rad
        uneven = self.screw_m * (np.sin(phase) - np.sin(self.screw_phase_rad))
        slipped = (time_s >= self.slip_time_s)[:, None] * self.slip_m
        return self._with_play(self.ratio * commanded_m) + uneven + slipped

    def _with_play(self, wanted_m: Array) -> Array:
        half = 0.5 * self.play_m
        if not half.any():
            return wanted_m
        given = np.empty_like(wanted_m)
        at = wanted_m[0] + half * self.play_start
        for row, wanted in enumerate(wanted_m):
            at = np.clip(at, wanted - half, wanted + half)
            given[row] = at
        return given


def ideal_actuation(cables: int) -> Actuation:
    """Actuators that do what they are told."""
    zero = np.zeros(cables)
    return Actuation(zero, zero, zero + 1.0, zero, 0.004, zero, zero, np.inf)
