"""Whether a single reading can be true."""

from __future__ import annotations

from math import isfinite

from cablesense_ros.can.fault import FaultKind


def reading_fault(tension_n: float, range_n: tuple[float, float]) -> FaultKind | None:
    """What is wrong with a reading in N, if anything.

    At or beyond an end of the range it says only that the tension lies there or further, so any
    force made of it would be false.
    """
    if not isfinite(tension_n):
        return FaultKind.NOT_FINITE
    low, high = range_n
    if tension_n >= high:
        return FaultKind.OVER_RANGE
    if tension_n <= low:
        return FaultKind.UNDER_RANGE
    return None
