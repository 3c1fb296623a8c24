"""A proportion of few cases, with the interval that few cases leave."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import sqrt
from typing import Any

Z95 = 1.959963984540054
"""Standard normal deviate that 2.5 % exceed."""


@dataclass(frozen=True)
class Proportion:
    """`hits` of `count` cases."""

    hits: int
    count: int

    @classmethod
    def of(cls, outcomes: Iterable[bool]) -> Proportion:
        """How many of the outcomes are true."""
        listed = [bool(outcome) for outcome in outcomes]
        return cls(sum(listed), len(listed))

    @property
    def value(self) -> float | None:
        """The share, None without a case."""
        return self.hits / self.count if self.count else None

    @property
    def ci95(self) -> tuple[float, float]:
        """Wilson's score interval, which holds for few cases and for shares of 0 and 1 too.

        E. B. Wilson, Journal of the American Statistical Association 22 (1927) 209-212.
        """
        if not self.count:
            return 0.0, 1.0
        share, weight = self.hits / self.count, Z95**2 / self.count
        middle = (share + weight / 2.0) / (1.0 + weight)
        half = sqrt(share * (1.0 - share) * weight + weight**2 / 4.0) / (1.0 + weight)
        # the ends are exact where nothing or everything hits; rounding must not cross them
        low = 0.0 if self.hits == 0 else middle - half
        high = 1.0 if self.hits == self.count else middle + half
        return low, high

    def as_json(self) -> dict[str, Any]:
        """Share, interval and counts."""
        return {
            "value": self.value,
            "ci95": list(self.ci95),
            "hits": self.hits,
            "count": self.count,
        }
