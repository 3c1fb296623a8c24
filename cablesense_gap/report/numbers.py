"""Numbers as a page shows them."""

from __future__ import annotations

import math

from cablesense_gap.verdict import Estimate


def newtons(value: float) -> str:
    """`3.20 N`: hundredths below 10 N, tenths above, no more than a sensor tells."""
    return f"{value:.2f} N" if abs(value) < 10.0 else f"{value:.1f} N"


def percent(share: float) -> str:
    """`93 %`; never 0 % or 100 % unless it is just that."""
    whole = round(100.0 * share)
    if whole >= 100 and share < 1.0:
        return "> 99 %"
    if whole <= 0 and share > 0.0:
        return "< 1 %"
    return f"{whole} %"


def with_interval(estimate: Estimate) -> tuple[str, str]:
    """Value and 95 % interval, to the digits that the interval leaves."""
    low, high = estimate.ci95
    width = high - low
    decimals = 3
    if width > 0.0:
        decimals = min(9, max(0, 1 - math.floor(math.log10(width))))
    elif estimate.value:
        decimals = min(9, max(0, 3 - math.floor(math.log10(abs(estimate.value)))))
    return f"{estimate.value:.{decimals}f}", f"{low:.{decimals}f} to {high:.{decimals}f}"


def listed(words: list[str], last: str = "and") -> str:
    """`a, b and c`."""
    if len(words) < 2:
        return "".join(words)
    return f"{', '.join(words[:-1])} {last} {words[-1]}"
