"""Whether the values of a tension sample can be true."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import Final

from cablesense_ros.sample_error import ProblemKind, SampleError

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

    def check(self, tensions_n: Sequence[float]) -> None:
        """Check (M,) readings in N; then `slack` holds the numbers (from 1) of slack cables.

        Raises:
            SampleError: a reading is not finite, saturated or implausible.
        """
        low, high = self._range_n or PLAUSIBLE_N
        lowest = min(tensions_n)
        if not (isfinite(sum(tensions_n)) and low < lowest and max(tensions_n) < high):
            raise self._problem(tensions_n)
        self.slack = (
            ()
            if lowest >= self.slack_below_n
            else tuple(
                number
                for number, tension in enumerate(tensions_n, start=1)
                if tension < self.slack_below_n
            )
        )

    def _problem(self, tensions_n: Sequence[float]) -> SampleError:
        low, high = self._range_n or PLAUSIBLE_N
        cable, tension = next(
            (number, tension)
            for number, tension in enumerate(tensions_n, start=1)
            if not low < tension < high
        )
        reading = f"effort of cable_{cable} is {tension:g} N"
        if not isfinite(tension):
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
