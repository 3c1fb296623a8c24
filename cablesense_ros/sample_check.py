"""Whether the values of a tension sample can be true."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cablesense_ros.sample_error import ProblemKind, SampleError

Array = NDArray[np.float64]

PLAUSIBLE_N: Final = (-20.0, 20_000.0)
"""A cable pulls: readings below are a fault, not an offset; above, no such arm holds."""


class SampleCheck:
    """Refuses what no cable carries or no sensor can tell; notes slack cables, which are no fault.

    A saturated reading says only that the tension lies at or beyond the sensor's limit, so any
    force made of it would be false.
    """

    def __init__(self, range_n: tuple[float, float] | None, slack_below_n: float) -> None:
        """`range_n` is the sensors' range, if the arm file gives one."""
        self._range_n = range_n
        self.slack_below_n = slack_below_n
        self.slack: tuple[int, ...] = ()

    def check(self, tensions_n: Array) -> None:
        """Check (M,) readings in N; then `slack` holds the numbers (from 1) of slack cables.

        Raises:
            SampleError: a reading is not finite, saturated or implausible.
        """
        lowest, highest = float(tensions_n.min()), float(tensions_n.max())
        low, high = self._range_n or PLAUSIBLE_N
        if not (low < lowest and highest < high):  # also when one is NaN
            raise self._problem(tensions_n)
        self.slack = (
            ()
            if lowest >= self.slack_below_n
            else tuple((np.flatnonzero(tensions_n < self.slack_below_n) + 1).tolist())
        )

    def _problem(self, tensions_n: Array) -> SampleError:
        low, high = self._range_n or PLAUSIBLE_N
        finite = np.isfinite(tensions_n)
        cable = int(np.argmin(finite & (tensions_n > low) & (tensions_n < high)))
        reading = f"effort of cable_{cable + 1} is {tensions_n[cable]:g} N"
        if not finite[cable]:
            return SampleError(ProblemKind.NOT_FINITE, f"{reading}; it must be a finite number")
        if self._range_n is None:
            return SampleError(
                ProblemKind.IMPLAUSIBLE,
                f"{reading}; no cable of such an arm is outside {low:g} … {high:g} N",
            )
        return SampleError(
            ProblemKind.SATURATED,
            f"{reading}, at the end of the sensors' range {low:g} … {high:g} N; unload the arm",
        )
